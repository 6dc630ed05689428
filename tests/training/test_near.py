"""Where a scene begins in front of its cameras."""

import dataclasses

import numpy as np
import pytest
import torch

from graphgs.rendering.splats import NEAR, render
from graphgs.scene.views import Views
from graphgs.training import train
from graphgs.training import trainer as trainer_module
from graphgs.training.config import TrainConfig
from graphgs.training.near import LEAST_POINTS, near_depths, scene_near
from tests.support.tiny_scene import COUNT, tiny_scene

K = np.array([[100.0, 0.0, 50.0], [0.0, 100.0, 40.0], [0.0, 0.0, 1.0]])


def _views(depths, is_test=None) -> Views:
    """Cameras on the z axis that look along it, `depths` before z = 0."""
    count = len(depths)
    viewmats = np.tile(np.eye(4), (count, 1, 1))
    viewmats[:, 2, 3] = depths
    names = tuple(f"{k}.png" for k in range(count))
    sizes = np.tile([100, 80], (count, 1))
    is_test = np.zeros(count, bool) if is_test is None else np.array(is_test)
    return Views(None, names, names, (None,) * count, sizes, np.tile(K, (count, 1, 1)), viewmats, is_test)


def _wall(count: int = 1000) -> np.ndarray:
    """Points on z = 0 within every view from 1 away."""
    rng = np.random.default_rng(0)
    return np.concatenate([rng.uniform(-0.3, 0.3, (count, 2)), np.zeros((count, 1))], axis=1)


def test_depth_of_the_points_in_view():
    np.testing.assert_allclose(near_depths(_views([1.0, 4.0]), _wall()), [1.0, 4.0])


def test_single_points_in_front_do_not_count():
    stray = np.tile([0.0, 0.0, -0.9], (5, 1))
    np.testing.assert_allclose(near_depths(_views([1.0]), np.concatenate([_wall(), stray])), [1.0])


def test_points_beside_and_behind_do_not_count():
    others = np.concatenate([np.tile([0.0, 0.0, -2.0], (900, 1)), np.tile([0.6, 0.0, -0.5], (900, 1))])
    np.testing.assert_allclose(near_depths(_views([1.0]), np.concatenate([_wall(), others])), [1.0])


def test_held_out_views_and_views_of_few_points_are_unknown():
    depths = near_depths(_views([1.0, 1.0], [True, False]), _wall())
    assert np.isnan(depths[0])
    assert np.isnan(near_depths(_views([1.0]), _wall(LEAST_POINTS - 1))).all()


def test_the_closest_views_decide():
    assert scene_near(np.array([np.nan] + [2.0] * 10 + [10.0] * 90), 0.2) == pytest.approx(0.4)
    assert scene_near(np.array([0.1] * 4 + [10.0] * 96), 0.2) == pytest.approx(2.0)  # but not a view that went astray
    assert scene_near(np.array([np.nan]), 0.2) == NEAR
    assert scene_near(np.array([5.0]), 0.0) == NEAR


def test_training_and_its_scene_share_the_near_plane(tmp_path_factory, tmp_path, monkeypatch):
    scene = tiny_scene(tmp_path_factory.mktemp("scene"))
    used = []
    rasterize = trainer_module.rasterize
    monkeypatch.setattr(
        trainer_module, "rasterize", lambda *args, **kw: (used.append(kw["near"]), rasterize(*args, **kw))[1]
    )
    config = TrainConfig(steps=4, max_splats=COUNT, near_fraction=0.5, consistency_from_fraction=0.0)
    splats = train(config, scene.views, scene.graph, scene.points, scratch=tmp_path).splats
    assert 0.8 < splats.near < 1.3  # half of what the nearest blobs, some 2 away, are
    assert set(used) == {splats.near}

    blot = dataclasses.replace(splats, means=torch.tensor([[0.0, 0.0, 0.7]]).expand(COUNT, 3))
    assert not render(blot, K, np.eye(4), 32, 32).alphas.any()
    assert render(dataclasses.replace(blot, near=NEAR), K, np.eye(4), 32, 32).alphas.any()
