"""Colour of each Gaussian seen from each camera, from spherical harmonics, and the adjoint: one thread per Gaussian.

colour = max(0, sum_k basis_k(direction) coefficients_k + 0.5), direction from the camera to the Gaussian (3DGS).
"""

from functools import cache

import warp as wp

from graphgs.kernels.launch import launch_range
from graphgs.kernels.sh import sh_basis, sh_sum


@cache
def shade_forward_kernel(real):
    vec2i, vec3, vec16 = wp.vec2i, wp.types.vector(3, real), wp.types.vector(16, real)

    @wp.kernel(enable_backward=False, module="unique")
    def shade_forward(
        first: int,
        # Gaussians
        means: wp.array(dtype=vec3),  # [N]
        sh_coeffs: wp.array2d(dtype=vec3),  # [N, K]
        degree: int,  # (degree + 1)^2 <= K
        # Cameras
        centers: wp.array(dtype=vec3),  # [C]
        radii: wp.array(dtype=vec2i),  # [C * N]
        # Out
        colors: wp.array(dtype=vec3),  # [C * N], 0 where not visible
    ):
        g = first + wp.tid()
        for c in range(centers.shape[0]):
            at = c * means.shape[0] + g
            color = vec3()
            if radii[at][0] > 0:
                basis = sh_basis(degree, wp.normalize(means[g] - centers[c]), vec16())
                for k in range((degree + 1) * (degree + 1)):
                    color += basis[k] * sh_coeffs[g, k]
                color = wp.max(color + vec3(real(0.5)), vec3())
            colors[at] = color

    return shade_forward


def shade(
    means: wp.array,  # [N] vec3, world
    sh_coeffs: wp.array,  # [N, K] vec3
    centers: wp.array,  # [C] vec3, world
    radii: wp.array,  # [C * N] vec2i
    colors: wp.array,  # [C * N] vec3, filled
    *,
    degree: int,
    threads: int = 1,
) -> None:
    launch_range(
        shade_forward_kernel(means.dtype._wp_scalar_type_),
        means.size,
        inputs=[means, sh_coeffs, degree, centers, radii],
        outputs=[colors],
        device=means.device,
        threads=threads,
        min_chunk=1024,
        chunks_per_thread=4,
    )


@cache
def shade_backward_kernel(real):
    vec2i, vec3, vec16 = wp.vec2i, wp.types.vector(3, real), wp.types.vector(16, real)

    @wp.kernel(enable_backward=False, module="unique")
    def shade_backward(
        first: int,
        # Gaussians
        means: wp.array(dtype=vec3),  # [N]
        sh_coeffs: wp.array2d(dtype=vec3),  # [N, K]
        degree: int,
        # Cameras
        centers: wp.array(dtype=vec3),  # [C]
        radii: wp.array(dtype=vec2i),  # [C * N]
        # Cotangents
        colors: wp.array(dtype=vec3),  # [C * N]
        v_colors: wp.array(dtype=vec3),  # [C * N]
        # Out
        v_means: wp.array(dtype=vec3),  # [N]
        v_sh_coeffs: wp.array2d(dtype=vec3),  # [N, K]
        v_directions: wp.array(dtype=vec3),  # [C * N] by the vector from camera to Gaussian; or empty
    ):
        g = first + wp.tid()
        v_mean = vec3()
        for k in range(sh_coeffs.shape[1]):
            v_sh_coeffs[g, k] = vec3()
        for c in range(centers.shape[0]):
            at = c * means.shape[0] + g
            v_offset = vec3()
            if radii[at][0] > 0:
                v_color = v_colors[at]
                for channel in range(3):
                    if colors[at][channel] <= real(0.0):  # clamped
                        v_color[channel] = real(0.0)
                offset = means[g] - centers[c]
                direction = wp.normalize(offset)
                weights = vec16()
                for k in range((degree + 1) * (degree + 1)):
                    weights[k] = wp.dot(sh_coeffs[g, k], v_color)
                _degree, v_direction, basis = wp.grad(sh_sum)(degree, direction, weights)
                for k in range((degree + 1) * (degree + 1)):
                    v_sh_coeffs[g, k] += basis[k] * v_color
                # Through the normalisation: only the part across the direction moves it.
                v_offset = (v_direction - wp.dot(v_direction, direction) * direction) / wp.length(offset)
                v_mean += v_offset
            if v_directions.shape[0] > 0:
                v_directions[at] = v_offset
        v_means[g] = v_mean

    return shade_backward


def shade_backward(
    means: wp.array,  # [N] vec3, world
    sh_coeffs: wp.array,  # [N, K] vec3
    centers: wp.array,  # [C] vec3, world
    radii: wp.array,  # [C * N] vec2i
    colors: wp.array,  # [C * N] vec3
    v_colors: wp.array,  # [C * N] vec3
    v_means: wp.array,  # [N] vec3, filled
    v_sh_coeffs: wp.array,  # [N, K] vec3, filled
    v_directions: wp.array,  # [C * N] vec3, filled; or empty
    *,
    degree: int,
    threads: int = 1,
) -> None:
    launch_range(
        shade_backward_kernel(means.dtype._wp_scalar_type_),
        means.size,
        inputs=[means, sh_coeffs, degree, centers, radii, colors, v_colors],
        outputs=[v_means, v_sh_coeffs, v_directions],
        device=means.device,
        threads=threads,
        min_chunk=1024,
        chunks_per_thread=4,
    )
