"""Compositing on a GPU, forward: a block of threads per tile, a thread per pixel, splats in shared batches."""

from functools import cache

import warp as wp

from graphgs.kernels.rasterize.blending import falloff_at, halves_light, sees_splats
from graphgs.kernels.rasterize.constants import ALPHA_MAX, ALPHA_MIN, TILE_SIZE, TRANSMITTANCE_MIN

THREADS = wp.constant(256)  # of a block: one per pixel of a tile


@wp.func
def find_pixel(tile: int, place: int, width: int, height: int):
    """Camera, column and row of a tile's pixel, by its place in the tile; some tiles reach beyond the image."""
    columns = (width + TILE_SIZE - 1) // TILE_SIZE
    rows = (height + TILE_SIZE - 1) // TILE_SIZE
    px = (tile % columns) * TILE_SIZE + place % TILE_SIZE
    py = ((tile // columns) % rows) * TILE_SIZE + place // TILE_SIZE
    return tile // (rows * columns), px, py


@wp.func
def block_max(value: int):
    """The largest value of all threads of the block; every thread must ask."""
    return wp.tile_max(wp.tile(value))[0]


@cache
def gpu_forward_kernel(channels: int):
    vecD = wp.types.vector(channels, wp.float32)

    @wp.kernel(enable_backward=False, module="unique", grid_stride=False)
    def gpu_forward(
        # Splats, [C * N]
        means2d: wp.array[wp.vec2],
        conics: wp.array[wp.vec3],
        depths: wp.array[float],
        opacities: wp.array[float],
        colors: wp.array[vecD],
        # Tiles
        splat_ids: wp.array[int],  # [I]
        tile_ranges: wp.array[wp.vec2i],  # [C * tiles]
        # Frame
        width: int,
        height: int,
        backgrounds: wp.array[vecD],  # [C]
        masks: wp.array[wp.uint8],  # [C * H * W], or empty
        # Out, [C * H * W]
        render_colors: wp.array[vecD],
        render_alphas: wp.array[float],
        render_depths: wp.array[float],
        median_depths: wp.array[float],  # or empty
        color_sums: wp.array[vecD],  # sum of w * color, without background
        # Out
        tile_stops: wp.array[int],  # [C * tiles] past the last intersection that a pixel took
    ):
        tile, thread = wp.tid()
        c, px, py = find_pixel(tile, thread, width, height)
        inside = px < width and py < height
        index = (c * height + py) * width + px
        pixel = wp.vec2(float(px) + 0.5, float(py) + 0.5)
        open = bool(False)
        if inside:
            open = sees_splats(masks, index)

        color = vecD()
        depth = float(0.0)
        median_depth = float(0.0)
        transmittance = float(1.0)
        weight_sum = float(0.0)  # 1 - transmittance, without the rounding of 1, which a faint pixel's depth would show
        first = tile_ranges[tile][0]
        last = tile_ranges[tile][1]
        stop = int(first)
        for start in range(first, last, THREADS):
            waiting = wp.where(open, 1, 0)
            if block_max(waiting) == 0:
                break
            s = int(0)
            spot = wp.vec4()
            conic = wp.vec3()
            if start + thread < last:
                s = splat_ids[start + thread]
                spot = wp.vec4(means2d[s][0], means2d[s][1], opacities[s], depths[s])
                conic = conics[s]
            ids = wp.tile(s)
            spots = wp.tile(spot, preserve_type=True)
            shapes = wp.tile(conic, preserve_type=True)
            for k in range(wp.min(THREADS, last - start)):
                if not open:
                    break
                here = wp.tile_extract(spots, k)
                offset = pixel - wp.vec2(here[0], here[1])
                alpha = wp.min(ALPHA_MAX, here[2] * falloff_at(offset, wp.tile_extract(shapes, k)))
                if alpha < ALPHA_MIN:
                    continue
                behind = transmittance * (1.0 - alpha)
                if behind <= TRANSMITTANCE_MIN:
                    open = False
                    break
                weight = alpha * transmittance
                color += weight * colors[wp.tile_extract(ids, k)]
                depth += weight * here[3]
                weight_sum += weight
                if halves_light(transmittance, behind):
                    median_depth = here[3]
                transmittance = behind
                stop = start + k + 1

        tile_stop = block_max(stop)
        if thread == 0:
            tile_stops[tile] = tile_stop
        if inside:
            alpha_sum = 1.0 - transmittance
            render_colors[index] = color + transmittance * backgrounds[c]
            render_alphas[index] = alpha_sum
            render_depths[index] = wp.where(weight_sum > 0.0, depth / weight_sum, 0.0)
            if median_depths.shape[0] > 0:
                median_depths[index] = median_depth
            color_sums[index] = color

    return gpu_forward
