"""Compositing, one thread per pixel: the plain shape, for float64, and to read.

The derivation of the adjoint is in docs/kernels.md. The backward kernel adds with atomics, so on the CPU, where Warp's
atomics are not atomic, it runs on one thread.
"""

from dataclasses import dataclass
from functools import cache

import warp as wp

from graphgs.kernels.launch import launch_range
from graphgs.kernels.rasterize.blending import falloff_at, halves_light, sees_splats
from graphgs.kernels.rasterize.buffers import Frame, Image, Splats, or_empty
from graphgs.kernels.rasterize.constants import ALPHA_MAX, ALPHA_MIN, TILE_SIZE, TRANSMITTANCE_MIN
from graphgs.kernels.rasterize.intersections import Intersections, intersect_tiles


@wp.func
def find_pixel(index: int, width: int, height: int):
    """Camera, tile and pixel column and row of a flat pixel index."""
    c = index // (width * height)
    py = (index // width) % height
    px = index % width
    columns = (width + TILE_SIZE - 1) // TILE_SIZE
    rows = (height + TILE_SIZE - 1) // TILE_SIZE
    return c, (c * rows + py // TILE_SIZE) * columns + px // TILE_SIZE, px, py


@cache
def pixels_forward_kernel(real, channels: int):
    vec2, vec3, vecD = (wp.types.vector(length, real) for length in (2, 3, channels))

    @wp.kernel(enable_backward=False, module="unique")
    def pixels_forward(
        first: int,
        # Splats, [C * N]
        means2d: wp.array(dtype=vec2),
        conics: wp.array(dtype=vec3),
        depths: wp.array(dtype=real),
        opacities: wp.array(dtype=real),
        colors: wp.array(dtype=vecD),
        # Tiles
        splat_ids: wp.array(dtype=int),  # [I]
        tile_ranges: wp.array(dtype=wp.vec2i),  # [C * tiles]
        # Frame
        width: int,
        height: int,
        backgrounds: wp.array(dtype=vecD),  # [C]
        masks: wp.array(dtype=wp.uint8),  # [C * H * W], or empty
        # Out, [C * H * W]
        render_colors: wp.array(dtype=vecD),
        render_alphas: wp.array(dtype=real),
        render_depths: wp.array(dtype=real),
        median_depths: wp.array(dtype=real),  # or empty
        color_sums: wp.array(dtype=vecD),  # sum of w * color, without background
    ):
        index = first + wp.tid()
        c, tile, px, py = find_pixel(index, width, height)
        pixel = vec2(real(px) + real(0.5), real(py) + real(0.5))
        last = wp.where(sees_splats(masks, index), tile_ranges[tile][1], 0)
        color = vecD()
        depth = real(0.0)
        median_depth = real(0.0)
        transmittance = real(1.0)
        weight_sum = real(0.0)  # 1 - transmittance, without the rounding of 1, which a faint pixel's depth would show
        for i in range(tile_ranges[tile][0], last):
            s = splat_ids[i]
            alpha = wp.min(real(ALPHA_MAX), opacities[s] * falloff_at(pixel - means2d[s], conics[s]))
            if alpha < real(ALPHA_MIN):
                continue
            behind = transmittance * (real(1.0) - alpha)
            if behind <= real(TRANSMITTANCE_MIN):
                break
            weight = alpha * transmittance
            color += weight * colors[s]
            depth += weight * depths[s]
            weight_sum += weight
            if halves_light(transmittance, behind):
                median_depth = depths[s]
            transmittance = behind
        alpha_sum = real(1.0) - transmittance
        render_colors[index] = color + transmittance * backgrounds[c]
        render_alphas[index] = alpha_sum
        render_depths[index] = wp.where(weight_sum > real(0.0), depth / weight_sum, real(0.0))
        if median_depths.shape[0] > 0:
            median_depths[index] = median_depth
        color_sums[index] = color

    return pixels_forward


@cache
def pixels_backward_kernel(real, channels: int):
    vec2, vec3, vecD = (wp.types.vector(length, real) for length in (2, 3, channels))

    @wp.kernel(enable_backward=False, module="unique")
    def pixels_backward(
        first: int,
        # Splats, [C * N]
        means2d: wp.array(dtype=vec2),
        conics: wp.array(dtype=vec3),
        depths: wp.array(dtype=real),
        opacities: wp.array(dtype=real),
        colors: wp.array(dtype=vecD),
        # Tiles
        splat_ids: wp.array(dtype=int),  # [I]
        tile_ranges: wp.array(dtype=wp.vec2i),  # [C * tiles]
        # Frame
        width: int,
        height: int,
        backgrounds: wp.array(dtype=vecD),  # [C]
        # Rendered, and cotangents, [C * H * W]
        render_alphas: wp.array(dtype=real),
        render_depths: wp.array(dtype=real),
        color_sums: wp.array(dtype=vecD),
        v_colors: wp.array(dtype=vecD),
        v_alphas: wp.array(dtype=real),
        v_depths: wp.array(dtype=real),
        v_median_depths: wp.array(dtype=real),  # or empty
        # Out, [C * N], zero before
        v_means2d: wp.array(dtype=vec2),
        v_conics: wp.array(dtype=vec3),
        v_splat_depths: wp.array(dtype=real),
        v_opacities: wp.array(dtype=real),
        v_splat_colors: wp.array(dtype=vecD),
        v_abs_means2d: wp.array(dtype=vec2),  # or empty
    ):
        index = first + wp.tid()
        alpha_sum = render_alphas[index]
        if alpha_sum <= real(0.0):  # a masked pixel, too
            return
        c, tile, px, py = find_pixel(index, width, height)
        pixel = vec2(real(px) + real(0.5), real(py) + real(0.5))

        # Cotangents of the plain sums over w: colour, depth, and w itself.
        v_color = v_colors[index]
        v_depth = v_depths[index] / alpha_sum
        v_light = v_alphas[index] - wp.dot(v_color, backgrounds[c])
        v_weight = v_light - v_depth * render_depths[index]
        v_median_depth = real(0.0)
        if v_median_depths.shape[0] > 0:
            v_median_depth = v_median_depths[index]
        # The part of the loss that still lies behind: sum over the remaining Gaussians of w * dL/dw. The depth, an
        # average, has no part in it at the start.
        remaining = v_light * alpha_sum + wp.dot(v_color, color_sums[index])

        transmittance = real(1.0)
        for i in range(tile_ranges[tile][0], tile_ranges[tile][1]):
            s = splat_ids[i]
            offset = pixel - means2d[s]
            conic = conics[s]
            falloff = falloff_at(offset, conic)
            alpha = wp.min(real(ALPHA_MAX), opacities[s] * falloff)
            if alpha < real(ALPHA_MIN):
                continue
            behind = transmittance * (real(1.0) - alpha)
            if behind <= real(TRANSMITTANCE_MIN):
                break
            weight = alpha * transmittance
            wp.atomic_add(v_splat_colors, s, weight * v_color)
            wp.atomic_add(v_splat_depths, s, weight * v_depth)
            if halves_light(transmittance, behind):
                wp.atomic_add(v_splat_depths, s, v_median_depth)
            gain = v_weight + wp.dot(v_color, colors[s]) + v_depth * depths[s]
            remaining -= weight * gain
            if opacities[s] * falloff <= real(ALPHA_MAX):  # the clamp has no gradient
                v_alpha = transmittance * gain - remaining / (real(1.0) - alpha)
                v_sigma = -alpha * v_alpha
                dx, dy = offset[0], offset[1]
                wp.atomic_add(v_opacities, s, falloff * v_alpha)
                half = real(0.5) * v_sigma
                wp.atomic_add(v_conics, s, vec3(half * dx * dx, v_sigma * dx * dy, half * dy * dy))
                v_offset = v_sigma * vec2(conic[0] * dx + conic[1] * dy, conic[1] * dx + conic[2] * dy)
                wp.atomic_add(v_means2d, s, -v_offset)
                if v_abs_means2d.shape[0] > 0:
                    wp.atomic_add(v_abs_means2d, s, wp.abs(v_offset))
            transmittance = behind

    return pixels_backward


@dataclass(frozen=True)
class PixelsState:
    """What the backward pass needs of the forward pass."""

    intersections: Intersections
    alphas: wp.array  # [C * H * W]
    depths: wp.array  # [C * H * W]
    color_sums: wp.array  # [C * H * W] vector of D channels


def _narrow(array: wp.array) -> wp.array:
    """As float32: tiles are found, and depths ordered, in single precision."""
    if array.dtype in (wp.float32, wp.vec2f):
        return array
    narrow = wp.empty(array.shape, dtype=wp.float32 if array.dtype is wp.float64 else wp.vec2f, device=array.device)
    wp.utils.array_cast(array, narrow)
    return narrow


def composite_pixels(
    splats: Splats,
    radii: wp.array,  # [C * N] vec2i [px], 0 = not visible
    frame: Frame,
    image: Image,
    *,
    threads: int = 1,
) -> PixelsState:
    """Fill `image`."""
    real, device = splats.depths.dtype, splats.depths.device
    intersections = intersect_tiles(
        _narrow(splats.means2d),
        radii,
        _narrow(splats.depths),
        cameras=frame.cameras,
        width=frame.width,
        height=frame.height,
    )
    color_sums = wp.empty(image.alphas.size, dtype=image.colors.dtype, device=device)
    launch_range(
        pixels_forward_kernel(real, splats.colors.dtype._length_),
        image.alphas.size,
        inputs=[*_inputs(splats, intersections, frame), or_empty(frame.masks, wp.uint8, device)],
        outputs=[
            image.colors,
            image.alphas,
            image.depths,
            or_empty(image.median_depths, real, device),
            color_sums,
        ],
        device=device,
        threads=threads,
    )
    return PixelsState(intersections, image.alphas, image.depths, color_sums)


def composite_pixels_backward(
    splats: Splats, frame: Frame, state: PixelsState, v_image: Image, v_splats: Splats, *, threads: int = 1
) -> None:
    """Add to `v_splats`, which must be zero before. One thread, whatever `threads` says: see above."""
    real, device = splats.depths.dtype, splats.depths.device
    launch_range(
        pixels_backward_kernel(real, splats.colors.dtype._length_),
        v_image.alphas.size,
        inputs=[
            *_inputs(splats, state.intersections, frame),
            state.alphas,
            state.depths,
            state.color_sums,
            v_image.colors,
            v_image.alphas,
            v_image.depths,
            or_empty(v_image.median_depths, real, device),
        ],
        outputs=[
            v_splats.means2d,
            v_splats.conics,
            v_splats.depths,
            v_splats.opacities,
            v_splats.colors,
            or_empty(v_splats.abs_means2d, splats.means2d.dtype, device),
        ],
        device=device,
    )


def _inputs(splats: Splats, intersections: Intersections, frame: Frame) -> list:
    return [
        splats.means2d,
        splats.conics,
        splats.depths,
        splats.opacities,
        splats.colors,
        intersections.splat_ids,
        intersections.tile_ranges,
        frame.width,
        frame.height,
        frame.backgrounds,
    ]
