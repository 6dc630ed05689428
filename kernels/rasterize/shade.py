"""Colour of each Gaussian seen from each camera, from spherical harmonics, and the adjoint: one thread per Gaussian.

colour = max(0, sum_k basis_k(direction) coefficients_k + 0.5), direction from the camera to the Gaussian (3DGS).
"""

from functools import cache

import warp as wp

from graphgs.kernels.launch import launch_range
from graphgs.kernels.sh import BAND_0, add_band, band_1, band_2, band_3, band_color, band_weights


@cache
def shade_forward_kernel(real):
    vec2i = wp.vec2i
    vec3, vec5, vec7 = (wp.types.vector(length, real) for length in (3, 5, 7))

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
                direction = wp.normalize(means[g] - centers[c])
                color = real(BAND_0) * sh_coeffs[g, 0]
                if degree >= 1:
                    _direction, basis_1 = wp.grad(band_1)(direction, vec3())
                    color += band_color(sh_coeffs, g, 1, basis_1)
                if degree >= 2:
                    _direction, basis_2 = wp.grad(band_2)(direction, vec5())
                    color += band_color(sh_coeffs, g, 4, basis_2)
                if degree >= 3:
                    _direction, basis_3 = wp.grad(band_3)(direction, vec7())
                    color += band_color(sh_coeffs, g, 9, basis_3)
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
    vec2i = wp.vec2i
    vec3, vec5, vec7 = (wp.types.vector(length, real) for length in (3, 5, 7))

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
                v_sh_coeffs[g, 0] += real(BAND_0) * v_color
                v_direction = vec3()
                if degree >= 1:
                    v_band, basis_1 = wp.grad(band_1)(direction, band_weights(sh_coeffs, g, 1, v_color, vec3()))
                    v_direction += v_band
                    add_band(v_sh_coeffs, g, 1, basis_1, v_color)
                if degree >= 2:
                    v_band, basis_2 = wp.grad(band_2)(direction, band_weights(sh_coeffs, g, 4, v_color, vec5()))
                    v_direction += v_band
                    add_band(v_sh_coeffs, g, 4, basis_2, v_color)
                if degree >= 3:
                    v_band, basis_3 = wp.grad(band_3)(direction, band_weights(sh_coeffs, g, 9, v_color, vec7()))
                    v_direction += v_band
                    add_band(v_sh_coeffs, g, 9, basis_3, v_color)
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
