"""The frozen yardstick renders what the product renders: a ratio of their times compares equal work."""

import torch

from bench.yardstick_step import yardstick_render
from graphgs.rendering import rasterize
from tests.support.gaussians import make_scene


def test_the_yardstick_does_the_same_work_as_the_product():
    scene = make_scene(120, 40, 30, sh_coeffs=16, background=False, seed=3)
    v_colors = torch.randn(1, 30, 40, 3, generator=torch.Generator().manual_seed(1))
    results = []
    for function in (yardstick_render, lambda *operands, **options: rasterize(*operands, **options).colors):
        leaves = scene.leaves(torch.float32)
        gaussians = [leaves[name] for name in ("means", "quats", "scales", "opacities", "colors", "viewmats")]
        colors = function(*gaussians, scene.Ks.float(), scene.width, scene.height, sh_degree=3)
        colors.backward(v_colors)
        results.append([colors.detach(), *(leaf.grad for leaf in gaussians)])
    for frozen, product in zip(*results, strict=True):
        # Both round at 6e-8; sums over pixels and the inverse of a thin covariance amplify that about 1000 times.
        assert (frozen - product).norm() <= 2e-4 * product.norm()
