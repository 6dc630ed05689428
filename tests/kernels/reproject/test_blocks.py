"""Reprojected colours compared by blocks of threads, against the plain shape."""

import numpy as np
import pytest
import warp as wp

from graphgs.kernels.reproject import DepthPair, compare_views

# pairs, height, width: one pixel; part of a block; several blocks with a rest; more than one pair
SIZES = [(1, 1, 1), (1, 9, 14), (2, 17, 33), (1, 40, 50)]


def operands(size, unit_depth, device):
    """A camera that moved a little, depths that agree but for an occluder, holes and faint pixels."""
    pairs, height, width = size
    generator = np.random.default_rng(1)
    focal = 40.0
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    ray = np.eye(3) if size[1:] == (1, 1) else K @ np.array([[1, 0, 0.02], [0, 1, 0], [-0.02, 0, 1]]) @ np.linalg.inv(K)
    shift = np.zeros(3) if size[1:] == (1, 1) else K @ [0.02, -0.01, 0.03]
    depth_i, depth_j = (2 + 0.05 * generator.random((pairs, height, width)) for _ in range(2))
    alpha_i = generator.random(depth_i.shape) ** 0.3
    alpha_i[:, 0, 0] = 1
    depth_i[:, 3:5] = 0
    depth_j[:, -6:-3] *= 0.7
    images = [generator.random((pairs, height, width, 3)) for _ in range(2)]
    maps = np.tile(np.concatenate([ray.ravel(), shift]), (pairs, 1))

    def flat(values):
        return wp.array(np.asarray(values).reshape(-1), dtype=float, device=device)

    shape = (height, width)
    depths = DepthPair(
        *(flat(depth_i), flat(alpha_i), shape, flat(depth_j), shape),
        *(flat(maps), unit_depth, flat([0.5, 0.05])),
    )
    return depths, *map(flat, images)


def compare(depths, image_i, image_j, shape):
    count, device = depths.depth_i.shape[0], depths.depth_i.device
    slopes = [wp.full(n, float("inf"), dtype=float, device=device) for n in (3 * count, count)]
    sums = wp.full(2, float("inf"), dtype=wp.float64, device=device)
    compare_views(depths, image_i, image_j, *slopes, sums, shape=shape)
    return [x.numpy() for x in (*slopes, sums)]


@pytest.mark.usefixtures("cpu_blocks")
@pytest.mark.parametrize("unit_depth", [False, True])
@pytest.mark.parametrize("size", SIZES)
def test_blocks_agree_with_the_plain_shape(size, unit_depth, device):
    scene = operands(size, unit_depth, device)
    blocks, plain = (compare(*scene, shape) for shape in ("blocks", "pixels"))
    assert blocks[2][1] == plain[2][1]  # matched pixels
    assert 0 < blocks[2][1] <= scene[0].depth_i.shape[0]
    # the same function for every pixel: what differs is how two compilations round, and the order of a sum
    for got, expected in zip(blocks, plain, strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-5)


def test_blocks_refuse_a_cpu_that_would_run_one_thread_of_each():
    assert not wp.config.enable_cpu_blocks
    with pytest.raises(RuntimeError, match="compare_reprojected_blocks: a kernel of blocks runs on the CPU"):
        compare(*operands((1, 9, 14), False, "cpu"), "blocks")
