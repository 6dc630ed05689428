"""The scene's size is robust."""

import numpy as np
import pytest

from graphgs.training.extent import scene_extent


def _ring(count: int = 40) -> np.ndarray:
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.stack([3 * np.cos(angles), 0 * angles, 3 * np.sin(angles)], 1)


def test_one_outlier_camera_changes_little():
    cameras = _ring()
    spoiled = np.concatenate([cameras, [[1e6, 0, 0]]])
    assert scene_extent(spoiled) == pytest.approx(scene_extent(cameras), rel=0.05)


def test_it_scales_with_the_scene():
    cameras = np.random.default_rng(0).normal(size=(30, 3))
    assert scene_extent(7.0 * cameras + 5.0) == pytest.approx(7.0 * scene_extent(cameras))


def test_a_disc_of_cameras_gives_the_value_of_3dgs():
    rng = np.random.default_rng(0)
    radius, angle = np.sqrt(rng.uniform(0, 1, 20_000)), rng.uniform(0, 2 * np.pi, 20_000)
    cameras = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], 1)
    assert scene_extent(cameras) == pytest.approx(1.1, rel=0.02)


def test_cameras_in_one_place_use_the_points():
    points = np.random.default_rng(0).normal(size=(50, 3))
    assert scene_extent(np.zeros((5, 3)), 4 * points) == pytest.approx(4 * scene_extent(np.zeros((5, 3)), points))
    assert scene_extent(np.zeros((5, 3))) == 1.0
