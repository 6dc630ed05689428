"""The basis, read off the sum that is linear in it, against the explicit polynomials."""

import numpy as np
import pytest
import torch
import warp as wp

from graphgs.kernels.sh import sh_basis
from tests.support.reference.sh import sh_basis as twin

vec16d = wp.types.vector(16, wp.float64)


@wp.kernel(enable_backward=False)
def evaluate(degree: int, directions: wp.array[wp.vec3d], basis: wp.array2d[wp.float64]):
    i = wp.tid()
    values = sh_basis(degree, directions[i], vec16d())
    for k in range(16):
        basis[i, k] = values[k]


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_basis_equals_the_twin(degree, device):
    directions = np.random.default_rng(0).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    basis = wp.zeros((50, 16), dtype=wp.float64, device=device)
    array = wp.from_numpy(directions, dtype=wp.vec3d, device=device)
    wp.launch(evaluate, dim=50, inputs=[degree, array], outputs=[basis], device=device)
    expected = twin(torch.from_numpy(directions)).numpy()
    expected[:, (degree + 1) ** 2 :] = 0
    np.testing.assert_allclose(basis.numpy(), expected, atol=1e-12)
