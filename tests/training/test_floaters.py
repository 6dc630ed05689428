"""Gaussians in free space are found by the training views that should see them."""

import dataclasses

import numpy as np
import pytest
import torch

from graphgs.graph import CameraGraph
from graphgs.rendering import rasterize
from graphgs.rendering.splats import TENSORS
from graphgs.scene.views import Views
from graphgs.training import train
from graphgs.training.config import TrainConfig
from graphgs.training.floaters import FloaterFinder
from tests.support.tiny_scene import COUNT, tiny_scene

SIDE = 48
K = np.array([[48.0, 0.0, 24.0], [0.0, 48.0, 24.0], [0.0, 0.0, 1.0]])
CAMERAS = 5  # side by side on x, all looking along z at a wall 4 away


def _finder(*, nears=0.5, is_test=(False,) * CAMERAS, edges=None) -> FloaterFinder:
    viewmats = np.tile(np.eye(4), (CAMERAS, 1, 1))
    viewmats[:, 0, 3] = -0.2 * np.arange(CAMERAS)
    names = tuple(f"{k}.png" for k in range(CAMERAS))
    sizes, is_test = np.full((CAMERAS, 2), SIDE), np.array(is_test)
    views = Views(None, names, names, (None,) * CAMERAS, sizes, np.tile(K, (CAMERAS, 1, 1)), viewmats, is_test)
    edges = [(i, j) for i in range(CAMERAS) for j in range(i + 1, CAMERAS)] if edges is None else edges
    graph = CameraGraph(
        names, viewmats[:, :3, :3], views.centers, np.array(edges).reshape(-1, 2), np.full(len(edges), 50), is_test
    )
    return FloaterFinder(views, graph, np.full(CAMERAS, nears))


def _gaussians(*extra) -> tuple[torch.Tensor, ...]:
    """A dense wall at z = 4, and small opaque Gaussians at `extra`; (means, quats, scales, opacities)."""
    x, y = torch.meshgrid(torch.linspace(-3, 4, 36), torch.linspace(-3, 3, 31), indexing="ij")
    wall = torch.stack([x.flatten(), y.flatten(), torch.full((x.numel(),), 4.0)], dim=1)
    means = torch.cat([torch.tensor(extra, dtype=torch.float32).reshape(-1, 3), wall])
    count = len(means)
    scales = torch.full((count, 3), 0.15)
    scales[: len(extra)] = 0.05
    return means, torch.tensor([1.0, 0, 0, 0]).repeat(count, 1), scales, torch.full((count,), 0.9)


def _unconfirmed(finder: FloaterFinder, gaussians, hidden_from=()):
    """Rows found; the first Gaussian is transparent in the views `hidden_from`."""

    def render(view, colors):
        opacities = gaussians[3].clone()
        if view in hidden_from:
            opacities[0] = 1e-6
        viewmat = torch.as_tensor(finder.views.viewmats[view : view + 1], dtype=torch.float32)
        K = torch.as_tensor(finder.views.Ks[view : view + 1], dtype=torch.float32)
        return rasterize(*gaussians[:3], opacities, colors, viewmat, K, SIDE, SIDE, median_depth=True)

    return torch.nonzero(finder.unconfirmed(gaussians[0], render))[:, 0].tolist()


def test_too_near_to_a_camera_that_has_it_in_view():
    means = torch.tensor([[0.0, 0.0, 0.4], [0.0, 0.0, 0.6], [0.0, 0.0, -0.4], [-0.4, 0.0, 0.4], [0.8, 0.0, 0.1]])
    assert _finder().too_near(means).tolist() == [True, False, False, False, True]


def test_held_out_and_unknown_views_judge_nothing():
    means = torch.tensor([[0.8, 0.0, 0.1]])
    assert not _finder(is_test=(False,) * 4 + (True,)).too_near(means).any()
    assert not _finder(nears=np.nan).too_near(means).any()


def test_a_surface_is_confirmed():
    assert _unconfirmed(_finder(), _gaussians()) == []


def test_what_one_view_has_alone_in_front_of_all_others_is_found():
    gaussians = _gaussians((0.4, 0.0, 2.0))
    assert _unconfirmed(_finder(), gaussians) == []
    assert _unconfirmed(_finder(), gaussians, hidden_from=(0, 1, 3, 4)) == [0]


def test_only_neighbors_in_the_graph_are_asked():
    gaussians = _gaussians((0.4, 0.0, 2.0))
    assert _unconfirmed(_finder(edges=[(0, 1), (2, 3)]), gaussians, hidden_from=(0, 1, 3, 4)) == []
    assert _unconfirmed(_finder(edges=[(1, 2), (2, 3)]), gaussians, hidden_from=(0, 1, 3, 4)) == [0]


def test_behind_a_surface_nobody_is_missed():
    gaussians = _gaussians((0.4, 0.0, 6.0))
    assert _unconfirmed(_finder(), gaussians) == []


@pytest.mark.parametrize("strategy", ["adaptive", "mcmc"])
def test_a_resumed_run_repeats_every_bit(tmp_path_factory, tmp_path, strategy):
    scene = tiny_scene(tmp_path_factory.mktemp("scene"))
    config = TrainConfig(
        steps=30, max_splats=COUNT, near_fraction=1.0, prune_near=True, prune_unconfirmed=True, strategy=strategy
    )
    config = dataclasses.replace(config, densify_from_fraction=1.0, consistency="none")

    def run(folder, **options):
        return train(config, scene.views, scene.graph, scene.points, scratch=tmp_path / folder, threads=1, **options)

    whole = run("whole")
    run("parts", stop_at=16)
    parts = run("parts")
    assert all(torch.equal(getattr(whole.splats, name), getattr(parts.splats, name)) for name in TENSORS)
    assert min(entry["num_splats"] for entry in whole.stats.curve) < COUNT  # the nearest blobs went
