"""Sums in a fixed order."""

import numpy as np
import pytest
import warp as wp

from graphgs.kernels.rasterize.ordered_sum import CHUNK, ordered_sum


@pytest.mark.parametrize("rows", [0, 1, int(CHUNK), int(CHUNK) + 1, int(CHUNK) ** 2 + 3])
def test_equals_numpy_and_does_not_depend_on_threads(rows):
    values = np.random.default_rng(rows).normal(size=(2, rows, 3))
    array = wp.from_numpy(values, dtype=wp.vec3d, device="cpu")
    sums = [ordered_sum(array, threads=threads).numpy() for threads in (1, 3)]
    assert sums[0].shape == (2, 1, 3)
    np.testing.assert_allclose(sums[0][:, 0], values.sum(axis=1), atol=1e-9)
    assert np.array_equal(sums[0], sums[1])
