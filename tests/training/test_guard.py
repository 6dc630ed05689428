"""What is not finite is caught, rolled back once, then stops the run; none of it is ever saved."""

import dataclasses

import numpy as np
import pytest
import torch

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.training import checkpoint as checkpoint_module
from graphgs.training import run, train
from graphgs.training.config import TrainConfig
from graphgs.training.images import TrainingImages
from graphgs.training.trainer import Trainer
from tests.support.tiny_scene import tiny_scene

CONFIG = TrainConfig(
    steps=40, consistency_from_fraction=0.25, exposure="affine", refine_poses=True, poses_from_fraction=0.25
)
AT_STEP = 14
NAN, INFINITE = float("nan"), float("inf")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return tiny_scene(tmp_path_factory.mktemp("scene"))


def _gaussian(name: str, value: float):
    def harm(trainer: Trainer) -> None:
        with torch.no_grad():
            trainer.parameters.values[name][3] = value

    return harm


def _pose(trainer: Trainer) -> None:
    trainer._poses.viewmats[trainer.view_of_step(trainer.done), 0, 3] = NAN


def _exposure(trainer: Trainer) -> None:
    trainer._exposure._rows.values[2, 5] = NAN


def _image(trainer: Trainer) -> None:
    of_step = TrainingImages.of_step

    def spoiled(step: int):
        trainer._images.of_step = of_step.__get__(trainer._images)  # this once
        view, photo, mask = trainer._images.of_step(step)
        return view, photo * NAN, mask

    trainer._images.of_step = spoiled


HARMS = {
    "image": _image,
    "pose": _pose,
    "exposure": _exposure,
    "scale 0": _gaussian("log_scales", -INFINITE),
    "scale too small for float32": _gaussian("log_scales", -120.0),
    "quaternion 0": _gaussian("quats", 0.0),
    "NaN quaternion": _gaussian("quats", NAN),
    "NaN centre": _gaussian("means", NAN),
    "infinite opacity": _gaussian("logit_opacities", INFINITE),
}


class _Told(Reporter):
    def __init__(self):
        self.warnings = []

    def warn(self, message):
        self.warnings.append(message)


@pytest.fixture
def saved(monkeypatch) -> list[str]:
    """Names of the checkpoints written; each is looked at."""
    names, save = [], checkpoint_module.save_checkpoint

    def checked(checkpoint, folder, name):
        for key, tensor in checkpoint.tensors.items():
            assert torch.isfinite(tensor).all(), f"{name} holds a {key} that is not finite"
        names.append(name)
        save(checkpoint, folder, name)

    monkeypatch.setattr(run, "save_checkpoint", checked)
    return names


def _harmed(monkeypatch, harm, times: int) -> None:
    """Do the harm before the steps from AT_STEP on, so many times; the guard looks at every step."""
    step, left = Trainer.step, [times]

    def harmed(trainer: Trainer):
        loss = step(trainer)
        if trainer.done >= AT_STEP and left[0] > 0:
            left[0] -= 1
            harm(trainer)
        return loss

    monkeypatch.setattr(Trainer, "step", harmed)
    monkeypatch.setattr(run, "READ_INTERVAL", 1)
    monkeypatch.setattr(run, "CHECK_INTERVAL", 1)


def _train(scene, scratch, **options):
    return train(CONFIG, scene.views, scene.graph, scene.points, scratch=scratch, seed=3, threads=1, **options)


@pytest.mark.parametrize("harm", HARMS)
def test_harm_done_once_is_rolled_back(scene, tmp_path, monkeypatch, saved, harm):
    _harmed(monkeypatch, HARMS[harm], 1)
    told = _Told()
    trained = _train(scene, tmp_path, reporter=told)
    assert (trained.stats.recoveries, trained.stats.steps_executed, len(told.warnings)) == (1, 40, 1)
    assert trained.splats.is_finite
    assert np.isfinite(trained.viewmats).all()
    assert np.isfinite(trained.exposures).all()
    assert saved.count("latest") >= 3  # at the start, after the roll-back, at the end


@pytest.mark.parametrize("harm", HARMS)
def test_harm_done_again_stops_the_run(scene, tmp_path, monkeypatch, saved, harm):
    _harmed(monkeypatch, HARMS[harm], 2)
    with pytest.raises(DataError, match="also after a roll-back") as caught:
        _train(scene, tmp_path)
    assert caught.value.hint
    assert saved
    monkeypatch.undo()
    assert _train(scene, tmp_path, stop_at=0).splats.is_finite


def test_a_plain_run_looks_at_its_poses_too(scene, tmp_path, monkeypatch):
    """A kernel draws nothing for a pose that is not finite: the loss stays finite, and the Gaussians learn black."""

    def harm(trainer: Trainer) -> None:
        trainer._viewmats[trainer.view_of_step(trainer.done)] = NAN

    _harmed(monkeypatch, harm, 1)
    config = dataclasses.replace(CONFIG, exposure="none", refine_poses=False)
    with pytest.raises(DataError, match="also after a roll-back"):  # a pose is not part of the state rolled back
        train(config, scene.views, scene.graph, scene.points, scratch=tmp_path, threads=1)


@pytest.mark.parametrize("name", ["viewmats", "Ks"])
def test_cameras_that_are_not_finite_are_refused_at_once(scene, tmp_path, name):
    array = getattr(scene.views, name).copy()
    array[2, 0, 0] = NAN
    views = dataclasses.replace(scene.views, **{name: array})
    with pytest.raises(DataError, match=r"1 views are not finite: 02\.png"):
        train(CONFIG, views, scene.graph, scene.points, scratch=tmp_path)
