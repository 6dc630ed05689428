"""The adjoint of shading by blocks against the plain one: partial blocks, several cameras, spare coefficients."""

import numpy as np
import pytest
import warp as wp

from graphgs.kernels.rasterize.gpu_shade import shade_backward_blocks
from graphgs.kernels.rasterize.shade import shade, shade_backward

pytestmark = pytest.mark.usefixtures("cpu_blocks")


@pytest.mark.parametrize(
    ("count", "cameras", "degree", "coefficients"),
    [(256, 1, 3, 16), (300, 2, 3, 16), (70, 3, 1, 9), (5, 1, 0, 1), (40, 2, 2, 17)],
)
def test_it_equals_the_plain_one(device, count, cameras, degree, coefficients):
    rng = np.random.default_rng(count)
    means, centers = rng.normal(size=(count, 3)), 4 + rng.normal(size=(cameras, 3))
    sh_coeffs = rng.normal(size=(count, coefficients, 3))
    v_colors = rng.normal(size=(cameras * count, 3))
    radii = np.where(rng.random((cameras * count, 1)) < 0.7, 3, 0).repeat(2, axis=1)

    def run(backward, real: type) -> list[np.ndarray]:
        vec3 = wp.types.vector(3, real)

        def array(values: np.ndarray) -> wp.array:
            return wp.array(values, dtype=vec3, device=device)

        seen = wp.array(radii, dtype=wp.vec2i, device=device)
        inputs = [array(means), array(sh_coeffs), array(centers), seen, array(np.zeros_like(v_colors))]
        shade(*inputs, degree=degree)
        outputs = [array(np.full(shape, np.inf)) for shape in (means.shape, sh_coeffs.shape, v_colors.shape)]
        backward(*inputs, array(v_colors), *outputs, degree=degree)
        return [output.numpy() for output in outputs]

    for got, want in zip(run(shade_backward_blocks, wp.float32), run(shade_backward, wp.float64), strict=True):
        # float32 rounds at 6e-8; a band adds up to seven products of numbers of size 10.
        assert np.abs(got - want).max() < 2e-5
