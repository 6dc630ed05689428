"""The training stage on a tiny scene: it learns, repeats, goes on, and never looks at a test view."""

import dataclasses
import os
import signal

import numpy as np
import pytest
import torch

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.rendering.splats import TENSORS, render
from graphgs.training import train
from graphgs.training import trainer as trainer_module
from graphgs.training.config import TrainConfig
from graphgs.training.images import TrainingImages
from tests.support.tiny_scene import COUNT, HEIGHT, WIDTH, tiny_scene

# every mechanism is at work within 40 steps: rounds after 8, 16 and 24, consistency from 20
SHORT = TrainConfig(
    steps=40,
    max_splats=COUNT + 20,
    densify_from_step=8,
    densify_from_fraction=1.0,
    densify_until_fraction=0.75,
    densify_interval=8,
    densify_gradient=1e-5,
    consistency_interval=2,
)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return tiny_scene(tmp_path_factory.mktemp("scene"))


def _train(scene, scratch, config=SHORT, **options):
    options = {"seed": 3, "threads": 1} | options
    trained = train(config, scene.views, scene.graph, scene.points, scratch=scratch, **options)
    return trained.splats, trained.stats


def _same(a, b) -> bool:
    return all(torch.equal(getattr(a, name), getattr(b, name)) for name in TENSORS)


def _test_error(scene, splats) -> float:
    """Mean squared error over the held-out views."""
    errors = []
    for i in np.flatnonzero(scene.views.is_test):
        truth = torch.from_numpy(scene.views.read(i)[0]).float() / 255
        with torch.no_grad():
            image = render(splats, scene.views.Ks[i], scene.views.viewmats[i], WIDTH, HEIGHT).colors[0].cpu()
        errors.append(float(((image - truth) ** 2).mean()))
    return float(np.mean(errors))


@pytest.fixture(scope="module")
def whole(scene, tmp_path_factory):
    """SHORT in one go."""
    return _train(scene, tmp_path_factory.mktemp("whole"))


def test_held_out_views_get_better(scene, tmp_path, device):
    config = TrainConfig(steps=200, consistency="none")
    start, _ = _train(scene, tmp_path / "a", config, stop_at=0, device=device)
    end, stats = _train(scene, tmp_path / "a", config, device=device)
    assert _test_error(scene, end) < 0.2 * _test_error(scene, start)
    assert stats.steps_executed == 200
    assert len(stats.curve) == 20
    assert stats.curve[-1]["loss"] < 0.5 * stats.curve[0]["loss"]


def test_the_limit_is_reached_and_holds(whole):
    splats, stats = whole
    assert len(splats) == SHORT.max_splats == stats.num_splats
    assert max(entry["num_splats"] for entry in stats.curve) <= SHORT.max_splats


def test_more_initial_points_than_the_limit(scene, tmp_path):
    splats, _ = _train(scene, tmp_path, dataclasses.replace(SHORT, steps=2, max_splats=10))
    assert len(splats) == 10


@pytest.mark.parametrize("stops", [[20], [7, 8, 23, 39]])
def test_a_run_in_slices_equals_the_whole_bit_for_bit(scene, tmp_path, whole, stops):
    for stop in stops:
        _, stats = _train(scene, tmp_path, stop_at=stop)
    splats, stats = _train(scene, tmp_path)
    assert _same(splats, whole[0])
    assert [e["loss"] for e in stats.curve] == pytest.approx([e["loss"] for e in whole[1].curve], rel=1e-6)


def test_checkpoints_by_the_clock_do_not_matter(scene, tmp_path, whole):
    splats, _ = _train(scene, tmp_path, dataclasses.replace(SHORT, checkpoint_s=0.0))
    assert _same(splats, whole[0])


def test_threads_do_not_matter(scene, tmp_path, whole):
    before = torch.get_num_threads()
    assert _same(_train(scene, tmp_path, threads=2)[0], whole[0])
    assert torch.get_num_threads() == before


def test_the_seed_matters(scene, tmp_path, whole):
    assert not _same(_train(scene, tmp_path, seed=4)[0], whole[0])


class _Interrupting(Reporter):
    def progress(self, done, total, note=""):
        if done == 20:
            self.act()


def test_an_interrupt_is_saved_then_raised(scene, tmp_path, whole):
    before = signal.getsignal(signal.SIGINT)  # ignored, where the tests run in the background
    reporter = _Interrupting()
    reporter.act = lambda: os.kill(os.getpid(), signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        _train(scene, tmp_path, reporter=reporter)
    resumed = []
    reporter.act = lambda: None
    reporter.event = lambda kind, **fields: resumed.append((kind, fields.get("step")))
    splats, _ = _train(scene, tmp_path, reporter=reporter)
    assert ("resumed", 20) in resumed
    assert _same(splats, whole[0])
    assert signal.getsignal(signal.SIGINT) is before


def test_a_changed_setting_starts_over(scene, tmp_path):
    _train(scene, tmp_path, stop_at=10)
    events = []
    reporter = Reporter()
    reporter.event = lambda kind, **fields: events.append(kind)
    _train(scene, tmp_path, dataclasses.replace(SHORT, ssim_weight=0.3), stop_at=11, reporter=reporter)
    assert "resumed" not in events


def _poison(monkeypatch, times: int) -> None:
    """The photometric loss is NaN at the 15th step, and at as many tries."""
    original, calls = trainer_module.photometric_loss, []

    def loss(*args, **kwargs):
        calls.append(None)
        value = original(*args, **kwargs)
        return value * float("nan") if len(calls) >= 15 and len(calls) < 15 + times else value

    monkeypatch.setattr(trainer_module, "photometric_loss", loss)


def test_one_divergence_is_rolled_back(scene, tmp_path, monkeypatch):
    _poison(monkeypatch, 1)
    warnings = []
    reporter = Reporter()
    reporter.warn = warnings.append
    splats, stats = _train(scene, tmp_path, reporter=reporter)
    assert splats.is_finite
    assert (stats.recoveries, stats.steps_executed, len(warnings)) == (1, 40, 1)
    assert "diverged" in warnings[0]


def test_a_second_divergence_stops_and_saves_nothing_bad(scene, tmp_path, monkeypatch):
    _poison(monkeypatch, 1000)
    with pytest.raises(DataError, match="not finite") as caught:
        _train(scene, tmp_path)
    assert caught.value.hint
    monkeypatch.undo()
    splats, _ = _train(scene, tmp_path, stop_at=0)
    assert splats.is_finite


@pytest.mark.parametrize("source", ["render", "truth", "both"])
def test_no_test_view_is_ever_read_or_rendered(scene, tmp_path, monkeypatch, source):
    views = scene.views
    read, rendered = set(), set()
    load, render_view = TrainingImages._load, trainer_module.Trainer._render
    of_view = TrainingImages.of_view
    monkeypatch.setattr(
        TrainingImages, "_load", lambda self, step: (read.add(self._view_of_step(step)), load(self, step))[1]
    )
    monkeypatch.setattr(TrainingImages, "of_view", lambda self, view: (read.add(view), of_view(self, view))[1])
    monkeypatch.setattr(
        trainer_module.Trainer,
        "_render",
        lambda self, view, *rest, **options: (rendered.add(view), render_view(self, view, *rest, **options))[1],
    )
    _train(scene, tmp_path, dataclasses.replace(SHORT, consistency_source=source, consistency_from_fraction=0.0))
    used = read | rendered
    assert used == set(np.flatnonzero(~views.is_test).tolist())


def test_a_test_view_as_target_is_refused(scene, tmp_path):
    class Leaking(type(scene.graph)):
        def top_targets(self, *args, **kwargs):
            return np.zeros((len(self.names), 1), dtype=np.int64)  # view 0 is a test view

    graph = Leaking(**{f.name: getattr(scene.graph, f.name) for f in dataclasses.fields(scene.graph)})
    with pytest.raises(ValueError, match=r"test view 00\.png"):
        train(SHORT, scene.views, graph, scene.points, scratch=tmp_path)


def test_a_drawn_test_view_is_refused(scene, tmp_path):
    views = dataclasses.replace(scene.views, is_test=np.arange(len(scene.views.names)) != 0)
    with pytest.raises(ValueError, match="not a training view"):
        train(dataclasses.replace(SHORT, consistency="none"), views, scene.graph, scene.points, scratch=tmp_path)


def test_consistency_changes_the_result(scene, tmp_path, whole):
    assert not _same(_train(scene, tmp_path, dataclasses.replace(SHORT, consistency="none"))[0], whole[0])


def test_no_training_view_is_explained(scene, tmp_path):
    views = dataclasses.replace(scene.views, is_test=np.ones(len(scene.views.names), dtype=bool))
    with pytest.raises(DataError, match="no view is left"):
        train(SHORT, views, scene.graph, scene.points, scratch=tmp_path)
