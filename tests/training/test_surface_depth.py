"""The loss against known surfaces: by hand, its gradient, and that held-out views have no part in it."""

import dataclasses

import numpy as np
import pytest
import torch

from graphgs.points import DenseCloud
from graphgs.rendering import RenderOutput
from graphgs.rendering.splats import render
from graphgs.training import train
from graphgs.training.config import TrainConfig
from graphgs.training.surface_depth import FINAL_SHARE, MOST_ERROR, SurfaceDepth
from tests.support.tiny_scene import HEIGHT, WIDTH, tiny_scene, tiny_surfaces

CONFIG = TrainConfig(steps=101, lambda_depth=0.5)


def _at(scene, view: int, pixels: list[tuple[int, int]], depths: list[float]) -> DenseCloud:
    """Surfaces at the middles of pixels (row, column) of a view."""
    rows, columns = np.array(pixels).T
    rays = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1) @ np.linalg.inv(scene.views.Ks[view]).T
    viewmat = scene.views.viewmats[view]
    world = (rays * np.array(depths)[:, None] - viewmat[:3, 3]) @ viewmat[:3, :3]
    count = len(rows)
    return DenseCloud(world, np.zeros((count, 3), np.uint8), np.full(count, 3), np.full(count, view), np.ones(count))


def _output(depths: torch.Tensor, alphas: torch.Tensor) -> RenderOutput:
    """A render of which only depths and alphas are looked at."""
    names = {field.name for field in dataclasses.fields(RenderOutput)}
    return RenderOutput(**(dict.fromkeys(names) | {"depths": depths, "alphas": alphas}))


def test_loss_is_the_mean_log_ratio_and_its_gradient(tmp_path, device):
    scene = tiny_scene(tmp_path)
    pixels = [(3, 5), (10, 20), (20, 30), (27, 39)]
    term = SurfaceDepth(CONFIG, scene.views, _at(scene, 1, pixels, [2.0, 2.0, 2.0, 2.0]), device=device)
    depths = torch.full((1, HEIGHT, WIDTH, 1), 9.0)
    alphas = torch.ones(1, HEIGHT, WIDTH, 1, device=device)
    for (row, column), depth in zip(pixels, (2.2, 1.9, 8.0, 2.4), strict=True):
        depths[0, row, column] = depth
    alphas[0, 27, 39] = 0.3  # hardly covered
    depths = depths.to(device).requires_grad_()
    loss = term.loss(1, _output(depths, alphas))
    assert loss.item() == pytest.approx((np.log(1.1) - np.log(0.95) + MOST_ERROR) / 4, rel=1e-5)
    loss.backward()
    expected = torch.zeros(1, HEIGHT, WIDTH, 1)
    expected[0, 3, 5], expected[0, 10, 20] = 1 / 2.2 / 4, -1 / 1.9 / 4
    assert torch.allclose(depths.grad.cpu(), expected, rtol=1e-5)


def test_exact_depths_cost_nothing_and_empty_pixels_no_nan(tmp_path):
    scene = tiny_scene(tmp_path)
    with torch.no_grad():
        out = render(scene.truth, scene.views.Ks[1], scene.views.viewmats[1], WIDTH, HEIGHT, sh_degree=0)
    covered = (out.alphas[0, ..., 0] > 0.6).nonzero().tolist()
    exact = _at(scene, 1, covered, [float(out.depths[0, r, c]) for r, c in covered])
    assert float(SurfaceDepth(CONFIG, scene.views, exact, device="cpu").loss(1, out)) == pytest.approx(0.0, abs=1e-5)
    nothing = torch.zeros(1, HEIGHT, WIDTH, 1, requires_grad=True)
    loss = SurfaceDepth(CONFIG, scene.views, exact, device="cpu").loss(1, _output(nothing, torch.zeros_like(nothing)))
    loss.backward()
    assert loss.item() == 0.0
    assert torch.equal(nothing.grad, torch.zeros_like(nothing))


def test_only_training_views_have_surfaces(tmp_path):
    scene = tiny_scene(tmp_path)
    term = SurfaceDepth(CONFIG, scene.views, tiny_surfaces(scene), device="cpu")
    with torch.no_grad():
        for i in range(len(scene.views.names)):
            out = render(scene.truth, scene.views.Ks[i], scene.views.viewmats[i], WIDTH, HEIGHT, sh_degree=0)
            assert (term.loss(i, out) is None) == scene.views.is_test[i]


def test_the_weight_falls(tmp_path):
    scene = tiny_scene(tmp_path)
    term = SurfaceDepth(CONFIG, scene.views, tiny_surfaces(scene), device="cpu")
    assert term.weight(0) == 0.5
    assert term.weight(50) == pytest.approx(0.5 * FINAL_SHARE**0.5)
    assert term.weight(100) == pytest.approx(0.5 * FINAL_SHARE)


def test_training_heeds_surfaces_and_repeats(tmp_path):
    scene = tiny_scene(tmp_path)
    config = TrainConfig(steps=30, lambda_depth=0.5)

    def means(folder: str, surfaces, **options) -> torch.Tensor:
        trained = train(
            config, scene.views, scene.graph, scene.points,
            surfaces=surfaces, scratch=tmp_path / folder, seed=1, threads=1, **options,
        )  # fmt: skip
        return trained.splats.means

    surfaces = tiny_surfaces(scene)
    with_them = means("a", surfaces)
    assert not torch.equal(with_them, means("b", None))
    assert torch.equal(means("b", None), means("c", DenseCloud.empty()))
    means("d", surfaces, stop_at=10)  # interrupted
    assert torch.equal(with_them, means("d", surfaces))
    moved = dataclasses.replace(surfaces, positions=surfaces.positions + 0.1)
    assert not torch.equal(with_them, means("d", moved))  # other surfaces, another run


def test_surfaces_of_held_out_views_change_nothing(tmp_path):
    scene = tiny_scene(tmp_path)
    surfaces, config = tiny_surfaces(scene), TrainConfig(steps=20, lambda_depth=0.5)
    held_out = scene.views.is_test[surfaces.views]
    wrong = dataclasses.replace(surfaces, positions=np.where(held_out[:, None], 0.3, surfaces.positions))
    first, second = (
        train(config, scene.views, scene.graph, scene.points, surfaces=s, scratch=tmp_path / name, threads=1)
        for s, name in ((surfaces, "a"), (wrong, "b"))
    )
    assert torch.equal(first.splats.means, second.splats.means)
