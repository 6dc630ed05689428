"""Splats: initial values, files, rendering."""

import numpy as np
import pytest
import torch

from graphgs.errors import DataError
from graphgs.points import PrunedPoints
from graphgs.rendering.splats import SH_C0, TENSORS, Splats, render


def _points(count: int, dtype=np.uint8) -> PrunedPoints:
    rng = np.random.default_rng(1)
    colors = rng.integers(0, 256, (count, 3)).astype(np.uint8)
    return PrunedPoints(
        positions=rng.normal(size=(count, 3)),
        colors=colors if dtype == np.uint8 else colors / 255.0,
        scales=rng.uniform(0.1, 0.5, count),
        representative=np.arange(count),
        coverage=0.0,
    )


@pytest.mark.parametrize("dtype", [np.uint8, np.float64])
def test_initial_values_are_those_of_3dgs(dtype):
    points = _points(5, dtype)
    splats = Splats.from_points(points)
    np.testing.assert_allclose(splats.means, points.positions, rtol=1e-6)
    np.testing.assert_allclose(splats.opacities, 0.1, rtol=1e-6)
    np.testing.assert_allclose(splats.scales, points.scales[:, None].repeat(3, 1), rtol=1e-6)
    colors = points.colors / 255.0 if dtype == np.uint8 else points.colors
    np.testing.assert_allclose(SH_C0 * splats.sh_coeffs[:, 0] + 0.5, np.maximum(colors, 1 / 255), atol=1e-6)
    assert not splats.sh_coeffs[:, 1:].any()
    assert all(getattr(splats, name).dtype == torch.float32 for name in TENSORS)


def test_save_and_load_give_the_same_bits(tmp_path):
    splats = Splats.from_points(_points(7))
    splats.save(tmp_path)
    loaded = Splats.load(tmp_path)
    assert loaded.sh_degree == splats.sh_degree
    assert all(torch.equal(getattr(loaded, name), getattr(splats, name)) for name in TENSORS)


def test_no_points_is_explained():
    with pytest.raises(DataError, match="no 3D points") as caught:
        Splats.from_points(_points(0))
    assert caught.value.hint


def test_wrong_shapes_are_refused():
    splats = Splats.from_points(_points(3))
    with pytest.raises(ValueError, match=r"quats: expected \[3, 4\], got \[3, 3\]"):
        Splats(splats.means, splats.means, splats.log_scales, splats.logit_opacities, splats.sh_coeffs)


def test_a_gaussian_shows_at_its_projection(device):
    points = PrunedPoints(
        np.array([[0.1, -0.05, 2.0]]), np.array([[1.0, 0.2, 0.2]]), np.array([0.05]), np.zeros(1), 0.0
    )
    splats = Splats.from_points(points, initial_opacity=0.9, device=device)
    K = np.array([[40.0, 0.0, 20.0], [0.0, 40.0, 12.0], [0.0, 0.0, 1.0]])
    out = render(splats, K, np.eye(4), 40, 24, sh_degree=0)
    row, column = divmod(int(out.alphas[0, ..., 0].argmax()), 40)
    assert (column, row) in {(21, 10), (22, 10), (21, 11), (22, 11)}  # (22, 11) is a corner of four pixels
    assert out.colors[0, row, column, 0] > 2 * out.colors[0, row, column, 1]


def test_a_black_point_can_still_learn():
    points = PrunedPoints(np.array([[0.0, 0.0, 2.0]]), np.zeros((1, 3), np.uint8), np.array([0.1]), np.zeros(1), 0.0)
    splats = Splats.from_points(points, initial_opacity=0.9)
    splats.sh_coeffs.requires_grad_()
    K = np.array([[40.0, 0.0, 20.0], [0.0, 40.0, 12.0], [0.0, 0.0, 1.0]])
    out = render(splats, K, np.eye(4), 40, 24, sh_degree=0)
    (1.0 - out.colors).sum().backward()
    assert (splats.sh_coeffs.grad[0, 0] < -1.0).all()  # brighter is better, and it knows
