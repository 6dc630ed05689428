"""Exposures of training photos: learned, gauge fixed, restored, and without any held-out photo."""

import dataclasses

import cv2
import numpy as np
import pytest
import torch

from graphgs.training import train
from graphgs.training.config import TrainConfig
from graphgs.training.exposure import Exposure
from tests.support.tiny_scene import TinyScene, tiny_scene

CONFIG = TrainConfig(steps=60, exposure="affine", consistency_from_fraction=0.2, consistency_source="both")
IS_TEST = np.array([True, False, False, False, True, False])


def _train(scene: TinyScene, scratch, config=CONFIG, **options):
    return train(config, scene.views, scene.graph, scene.points, scratch=scratch, **{"seed": 3, "threads": 1} | options)


@pytest.fixture(scope="module")
def gains() -> np.ndarray:
    """Of every photo, in random order."""
    return np.random.default_rng(5).permutation(2.0 ** np.linspace(-0.45, 0.0, 9))


@pytest.fixture(scope="module")
def scene(tmp_path_factory, gains) -> TinyScene:
    """Every photo under an exposure of its own, up to a stop apart (display values, gamma 2.2)."""
    folder = tmp_path_factory.mktemp("scene")
    made = tiny_scene(folder)
    for name, gain in zip(made.views.images, gains, strict=True):
        photo = cv2.imread(str(folder / name))
        cv2.imwrite(str(folder / name), (photo * gain).round().astype(np.uint8))
    return made


def _exposure(config=CONFIG) -> Exposure:
    return Exposure(config, IS_TEST, device="cpu")


def _descend(exposure: Exposure, view: int, step: int, wanted: float) -> None:
    colors = torch.full((1, 2, 3, 3), 0.5)
    ((exposure.apply(view, colors) - wanted * colors) ** 2).sum().backward()
    exposure.step(view, step, 1.0)


def _grey(transforms: np.ndarray) -> np.ndarray:
    """[N] what every view makes of mid grey."""
    return (transforms @ [0.5, 0.5, 0.5, 1.0]).mean(axis=1)


def test_it_starts_as_the_identity():
    colors = torch.rand(1, 2, 3, 3)
    for view in np.flatnonzero(~IS_TEST):
        torch.testing.assert_close(_exposure().apply(int(view), colors), colors)
    assert np.array_equal(_exposure().transforms(), np.tile(np.eye(3, 4, dtype=np.float32), (6, 1, 1)))


def test_the_transform_mixes_channels_and_adds():
    exposure = _exposure()
    wanted = np.arange(12, dtype=np.float32).reshape(3, 4) / 10
    state = exposure.state()
    state["values"] = state["values"].clone()
    state["values"][0] = torch.from_numpy(wanted - np.eye(3, 4, dtype=np.float32)).flatten()
    exposure.load_state(state)
    colors = torch.rand(1, 2, 3, 3)
    expected = np.einsum("ij,bhwj->bhwi", wanted[:, :3], colors.numpy()) + wanted[:, 3]
    for applied in (exposure.apply(1, colors), exposure.applied_fixed(1, colors)):
        np.testing.assert_allclose(applied.detach().numpy(), expected, rtol=1e-5)


def test_the_mean_over_training_views_stays_the_identity():
    exposure = _exposure()
    for step in range(30):
        view = (1, 2, 3, 5)[step % 4]
        _descend(exposure, view, step, 1.05 + 0.1 * (view - 2.75))  # on the whole brighter
    transforms = exposure.transforms()
    mean = transforms[~IS_TEST].mean(0)
    np.testing.assert_allclose(mean, np.eye(3, 4), atol=1e-6)  # rounding in float32
    assert _grey(transforms)[5] > _grey(transforms)[1] + 0.05
    assert np.array_equal(transforms[0], np.eye(3, 4))


def test_a_view_that_is_not_drawn_moves_only_with_the_gauge():
    exposure = _exposure()
    for step in range(4):
        _descend(exposure, 5, step, 1.5)
    transforms = exposure.transforms()
    assert np.array_equal(transforms[1], transforms[2])
    moved = transforms[5] - np.eye(3, 4)
    np.testing.assert_allclose(transforms[1] - np.eye(3, 4), -moved / 3, atol=1e-6)


def test_the_penalty_pulls_towards_the_identity():
    exposure = _exposure(dataclasses.replace(CONFIG, exposure_weight=2.0))
    start = torch.zeros(4, 12)
    start[0], start[1] = 0.3, -0.3
    exposure.load_state(exposure.state() | {"values": start})
    exposure.apply(1, torch.rand(1, 2, 3, 3))
    penalty = exposure.penalty()
    assert penalty.item() == pytest.approx(2.0 * 12 * 0.3**2)
    penalty.backward()
    exposure.step(1, 0, 1.0)
    distances = ((exposure.transforms() - np.eye(3, 4)) ** 2).sum(axis=(1, 2))
    assert distances[1] < 12 * 0.3**2


@pytest.mark.parametrize("call", ["apply", "step"])
def test_a_held_out_view_is_refused(call):
    exposure = _exposure()
    with pytest.raises(ValueError, match="held out"):
        exposure.apply(0, torch.rand(1, 2, 3, 3)) if call == "apply" else exposure.step(4, 0, 1.0)


def test_exposures_of_the_photos_are_found(scene, tmp_path, gains):
    trained = _train(scene, tmp_path, dataclasses.replace(CONFIG, steps=300, consistency="none"))
    training = ~scene.views.is_test
    found = _grey(trained.exposures)[training]
    assert np.corrcoef(found, gains[training])[0, 1] > 0.95
    plain = _train(scene, tmp_path, TrainConfig(steps=300, consistency="none"))
    assert plain.exposures is None
    assert trained.stats.curve[-1]["loss"] < 0.8 * plain.stats.curve[-1]["loss"]


def test_a_run_in_slices_equals_the_whole_bit_for_bit(scene, tmp_path):
    whole = _train(scene, tmp_path / "whole")
    for stop in (13, 31):
        _train(scene, tmp_path / "slices", stop_at=stop)
    sliced = _train(scene, tmp_path / "slices")
    assert np.array_equal(sliced.exposures, whole.exposures)
    assert torch.equal(sliced.splats.sh_coeffs, whole.splats.sh_coeffs)
    assert not np.array_equal(whole.exposures[1], np.eye(3, 4))
    whole.save(tmp_path)
    assert np.array_equal(type(whole).load(tmp_path).exposures, whole.exposures)
