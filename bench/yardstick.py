"""The yardstick: compositing by one thread per pixel, as it was before anything was made fast. Frozen.

Milliseconds mean little on another machine, or on a busy one; the ratio of two times from one run does. But a ratio
means something only against something that never changes. So this file holds its own copy of the plain kernels (three
channels, float32 and float64), of their tile lists and of the thresholds, and is never improved, nor follows the
product's plain shape when that grows. `yardstick_hash` is stored with a baseline: a ratio to another hash is refused.

The backward kernel adds with atomics, so on the CPU, where Warp's atomics are not atomic, it runs on one thread.
"""

import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import warp as wp

from graphgs.kernels.launch import launch_range
from graphgs.kernels.rasterize.buffers import Frame, Image, Splats

wp.set_module_options({"enable_backward": False})

ALPHA_MIN = wp.constant(1.0 / 255.0)
ALPHA_MAX = wp.constant(0.99)
TRANSMITTANCE_MIN = wp.constant(1e-4)
TILE_SIZE = wp.constant(16)  # [px]


def yardstick_hash() -> str:
    """SHA-256 of this file."""
    return hashlib.sha256(Path(__file__).read_text(encoding="utf-8").encode()).hexdigest()


@wp.struct
class Grid:
    columns: int  # tiles per image row
    rows: int
    splats: int  # per camera


@dataclass(frozen=True)
class Intersections:
    splat_ids: wp.array  # [I] int, tile by tile, front to back
    tile_ranges: wp.array  # [C * tiles] vec2i: first, last + 1


@wp.func
def tile_box(mean2d: wp.vec2, radius: wp.vec2i, grid: Grid):
    """First and last + 1 column and row of the tiles under a splat's bounding box."""
    size = float(TILE_SIZE)
    left = wp.clamp(int(wp.floor((mean2d[0] - float(radius[0])) / size)), 0, grid.columns)
    right = wp.clamp(int(wp.ceil((mean2d[0] + float(radius[0])) / size)), 0, grid.columns)
    top = wp.clamp(int(wp.floor((mean2d[1] - float(radius[1])) / size)), 0, grid.rows)
    bottom = wp.clamp(int(wp.ceil((mean2d[1] + float(radius[1])) / size)), 0, grid.rows)
    return left, right, top, bottom


@wp.kernel
def count_tiles(
    # Splats, [C * N]
    means2d: wp.array[wp.vec2],
    radii: wp.array[wp.vec2i],
    grid: Grid,
    # Out
    counts: wp.array[int],  # [C * N]
):
    s = wp.tid()
    count = 0
    if radii[s][0] > 0:
        left, right, top, bottom = tile_box(means2d[s], radii[s], grid)
        count = (right - left) * (bottom - top)
    counts[s] = count


@wp.kernel
def emit_keys(
    # Splats, [C * N]
    means2d: wp.array[wp.vec2],
    radii: wp.array[wp.vec2i],
    depths: wp.array[float],
    ends: wp.array[int],  # inclusive sum of `counts`
    grid: Grid,
    # Out, [2 * I]
    keys: wp.array[wp.int64],  # tile, then depth: a positive float sorts like its bits
    splat_ids: wp.array[int],
):
    s = wp.tid()
    if radii[s][0] > 0:
        left, right, top, bottom = tile_box(means2d[s], radii[s], grid)
        at = ends[s] - (right - left) * (bottom - top)
        depth_bits = wp.int64(wp.cast(depths[s], int))
        first_tile = (s // grid.splats) * grid.rows * grid.columns
        for row in range(top, bottom):
            for column in range(left, right):
                keys[at] = (wp.int64(first_tile + row * grid.columns + column) << wp.int64(32)) | depth_bits
                splat_ids[at] = s
                at += 1


@wp.kernel
def find_ranges(
    keys: wp.array[wp.int64],  # [I] sorted
    count: int,
    # Out
    tile_ranges: wp.array[wp.vec2i],  # [C * tiles], zero before
):
    i = wp.tid()
    tile = int(keys[i] >> wp.int64(32))
    if i == 0 or int(keys[i - 1] >> wp.int64(32)) != tile:
        tile_ranges[tile][0] = i
    if i == count - 1 or int(keys[i + 1] >> wp.int64(32)) != tile:
        tile_ranges[tile][1] = i + 1


def intersect_tiles(
    means2d: wp.array,  # [C * N] vec2, float32
    radii: wp.array,  # [C * N] vec2i
    depths: wp.array,  # [C * N], float32
    *,
    cameras: int,
    width: int,
    height: int,
) -> Intersections:
    """Reads one number back from the device: the count of intersections."""
    device = means2d.device
    size = int(TILE_SIZE)
    grid = Grid()
    grid.columns, grid.rows, grid.splats = -(-width // size), -(-height // size), max(1, means2d.size // cameras)
    tile_ranges = wp.zeros(cameras * grid.rows * grid.columns, dtype=wp.vec2i, device=device)
    if means2d.size == 0:
        return Intersections(wp.empty(0, dtype=int, device=device), tile_ranges)
    ends = wp.empty(means2d.size, dtype=int, device=device)
    wp.launch(count_tiles, dim=means2d.size, inputs=[means2d, radii, grid], outputs=[ends], device=device)
    wp.utils.array_scan(ends, ends, inclusive=True)
    count = int(ends[-1:].numpy()[0])
    keys = wp.empty(2 * count, dtype=wp.int64, device=device)  # the sort wants room for a second copy
    splat_ids = wp.empty(2 * count, dtype=int, device=device)
    if count > 0:
        inputs = [means2d, radii, depths, ends, grid]
        wp.launch(emit_keys, dim=means2d.size, inputs=inputs, outputs=[keys, splat_ids], device=device)
        wp.utils.radix_sort_pairs(keys, splat_ids, count)
        wp.launch(find_ranges, dim=count, inputs=[keys, count], outputs=[tile_ranges], device=device)
    return Intersections(splat_ids, tile_ranges)


@wp.func
def find_pixel(index: int, width: int, height: int):
    """Camera, tile and pixel column and row of a flat pixel index."""
    c = index // (width * height)
    py = (index // width) % height
    px = index % width
    columns = (width + TILE_SIZE - 1) // TILE_SIZE
    rows = (height + TILE_SIZE - 1) // TILE_SIZE
    return c, (c * rows + py // TILE_SIZE) * columns + px // TILE_SIZE, px, py


@wp.func
def falloff_at(offset: Any, conic: Any):
    """exp(-sigma) at an offset from the mean [px]; sigma is half the squared Mahalanobis distance."""
    dx, dy = offset[0], offset[1]
    return wp.exp(-(offset.dtype(0.5) * (conic[0] * dx * dx + conic[2] * dy * dy) + conic[1] * dx * dy))


@cache
def pixels_forward_kernel(real):
    vec2, vec3, vec4 = (wp.types.vector(length, real) for length in (2, 3, 4))

    @wp.kernel(enable_backward=False, module="unique")
    def pixels_forward(
        first: int,
        # Splats, [C * N]
        means2d: wp.array(dtype=vec2),
        conics: wp.array(dtype=vec3),
        depths: wp.array(dtype=real),
        opacities: wp.array(dtype=real),
        colors: wp.array(dtype=vec3),
        # Tiles
        splat_ids: wp.array(dtype=int),  # [I]
        tile_ranges: wp.array(dtype=wp.vec2i),  # [C * tiles]
        # Frame
        width: int,
        height: int,
        backgrounds: wp.array(dtype=vec3),  # [C]
        # Out, [C * H * W]
        render_colors: wp.array(dtype=vec3),
        render_alphas: wp.array(dtype=real),
        render_depths: wp.array(dtype=real),
        sums: wp.array(dtype=vec4),  # sum of w * (color, depth), without background
    ):
        index = first + wp.tid()
        c, tile, px, py = find_pixel(index, width, height)
        pixel = vec2(real(px) + real(0.5), real(py) + real(0.5))
        color = vec3()
        depth = real(0.0)
        transmittance = real(1.0)
        for i in range(tile_ranges[tile][0], tile_ranges[tile][1]):
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
            transmittance = behind
        alpha_sum = real(1.0) - transmittance
        render_colors[index] = color + transmittance * backgrounds[c]
        render_alphas[index] = alpha_sum
        render_depths[index] = wp.where(alpha_sum > real(0.0), depth / alpha_sum, real(0.0))
        sums[index] = vec4(color[0], color[1], color[2], depth)

    return pixels_forward


@cache
def pixels_backward_kernel(real):
    vec2, vec3, vec4 = (wp.types.vector(length, real) for length in (2, 3, 4))

    @wp.kernel(enable_backward=False, module="unique")
    def pixels_backward(
        first: int,
        # Splats, [C * N]
        means2d: wp.array(dtype=vec2),
        conics: wp.array(dtype=vec3),
        depths: wp.array(dtype=real),
        opacities: wp.array(dtype=real),
        colors: wp.array(dtype=vec3),
        # Tiles
        splat_ids: wp.array(dtype=int),  # [I]
        tile_ranges: wp.array(dtype=wp.vec2i),  # [C * tiles]
        # Frame
        width: int,
        height: int,
        backgrounds: wp.array(dtype=vec3),  # [C]
        # Rendered, and cotangents, [C * H * W]
        render_alphas: wp.array(dtype=real),
        sums: wp.array(dtype=vec4),
        v_colors: wp.array(dtype=vec3),
        v_alphas: wp.array(dtype=real),
        v_depths: wp.array(dtype=real),
        # Out, [C * N], zero before
        v_means2d: wp.array(dtype=vec2),
        v_conics: wp.array(dtype=vec3),
        v_splat_depths: wp.array(dtype=real),
        v_opacities: wp.array(dtype=real),
        v_splat_colors: wp.array(dtype=vec3),
    ):
        index = first + wp.tid()
        alpha_sum = render_alphas[index]
        if alpha_sum <= real(0.0):
            return
        c, tile, px, py = find_pixel(index, width, height)
        pixel = vec2(real(px) + real(0.5), real(py) + real(0.5))

        # Cotangents of the plain sums over w: colour, depth, and w itself.
        total = sums[index]
        v_color = v_colors[index]
        v_depth = v_depths[index] / alpha_sum
        v_weight = v_alphas[index] - wp.dot(v_color, backgrounds[c]) - v_depth * total[3] / alpha_sum
        # The part of the loss that still lies behind: sum over the remaining Gaussians of w * dL/dw.
        remaining = v_weight * alpha_sum + v_depth * total[3]
        remaining += v_color[0] * total[0] + v_color[1] * total[1] + v_color[2] * total[2]

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
            transmittance = behind

    return pixels_backward


@dataclass(frozen=True)
class YardstickState:
    """What the backward pass needs of the forward pass."""

    intersections: Intersections
    alphas: wp.array  # [C * H * W]
    sums: wp.array  # [C * H * W] vec4


def _narrow(array: wp.array) -> wp.array:
    """As float32: tiles are found, and depths ordered, in single precision."""
    if array.dtype in (wp.float32, wp.vec2f):
        return array
    narrow = wp.empty(array.shape, dtype=wp.float32 if array.dtype is wp.float64 else wp.vec2f, device=array.device)
    wp.utils.array_cast(array, narrow)
    return narrow


def composite_yardstick(
    splats: Splats,
    radii: wp.array,  # [C * N] vec2i [px], 0 = not visible
    frame: Frame,
    image: Image,
    *,
    threads: int = 1,
) -> YardstickState:
    """Fill `image`."""
    device = splats.depths.device
    intersections = intersect_tiles(
        _narrow(splats.means2d),
        radii,
        _narrow(splats.depths),
        cameras=frame.cameras,
        width=frame.width,
        height=frame.height,
    )
    sums = wp.empty(image.alphas.size, dtype=wp.types.vector(4, splats.depths.dtype), device=device)
    launch_range(
        pixels_forward_kernel(splats.depths.dtype),
        image.alphas.size,
        inputs=[*_inputs(splats, intersections, frame)],
        outputs=[image.colors, image.alphas, image.depths, sums],
        device=device,
        threads=threads,
    )
    return YardstickState(intersections, image.alphas, sums)


def composite_yardstick_backward(
    splats: Splats, frame: Frame, state: YardstickState, v_image: Image, v_splats: Splats, *, threads: int = 1
) -> None:
    """Add to `v_splats`, which must be zero before. One thread, whatever `threads` says: see above."""
    launch_range(
        pixels_backward_kernel(splats.depths.dtype),
        v_image.alphas.size,
        inputs=[
            *_inputs(splats, state.intersections, frame),
            state.alphas,
            state.sums,
            v_image.colors,
            v_image.alphas,
            v_image.depths,
        ],
        outputs=[v_splats.means2d, v_splats.conics, v_splats.depths, v_splats.opacities, v_splats.colors],
        device=splats.depths.device,
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
