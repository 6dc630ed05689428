"""The basis, read off sums that are linear in it, against the explicit polynomials."""

import numpy as np
import torch
import warp as wp

from graphgs.kernels.sh import BAND_0, band_1, band_2, band_3
from tests.support.reference.sh import sh_basis as twin

vec5d = wp.types.vector(5, wp.float64)
vec7d = wp.types.vector(7, wp.float64)


@wp.kernel(enable_backward=False)
def evaluate(directions: wp.array[wp.vec3d], basis: wp.array2d[wp.float64]):
    i = wp.tid()
    basis[i, 0] = wp.float64(BAND_0)
    _direction, values_1 = wp.grad(band_1)(directions[i], wp.vec3d())
    for k in range(3):
        basis[i, 1 + k] = values_1[k]
    _direction, values_2 = wp.grad(band_2)(directions[i], vec5d())
    for k in range(5):
        basis[i, 4 + k] = values_2[k]
    _direction, values_3 = wp.grad(band_3)(directions[i], vec7d())
    for k in range(7):
        basis[i, 9 + k] = values_3[k]


def test_the_basis_equals_the_twin(device):
    directions = np.random.default_rng(0).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    basis = wp.zeros((50, 16), dtype=wp.float64, device=device)
    array = wp.from_numpy(directions, dtype=wp.vec3d, device=device)
    wp.launch(evaluate, dim=50, inputs=[array], outputs=[basis], device=device)
    np.testing.assert_allclose(basis.numpy(), twin(torch.from_numpy(directions)).numpy(), atol=1e-12)
