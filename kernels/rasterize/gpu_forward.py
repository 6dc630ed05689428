"""Compositing on a GPU, forward: a block of threads per tile, a thread per pixel, splats in shared batches."""

from functools import cache

import warp as wp

from graphgs.kernels.rasterize.constants import TILE_SIZE
from graphgs.kernels.rasterize.warps import THREADS, warps

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

BATCH = 128  # splats in shared memory at a time


@wp.func
def tile_corner(tile: int, width: int, height: int):
    """Camera of a tile, and its first pixel's column and row; some tiles reach beyond the image."""
    columns = (width + TILE_SIZE - 1) // TILE_SIZE
    rows = (height + TILE_SIZE - 1) // TILE_SIZE
    return tile // (rows * columns), (tile % columns) * TILE_SIZE, ((tile // columns) % rows) * TILE_SIZE


_BLEND = """
    WARP_SHARED int warp_open[8], warp_stop[8];
    float light[lanes], depth[lanes], weights[lanes], median[lanes], color[lanes][channels];
    int taken_to[lanes];
    unsigned open = 0;  // lanes whose pixels take splats, and before `ballot` those that this thread runs
    for (int l = 0; l < lanes; ++l) {
        const int lane = first_lane + l, px = block_left + (lane & 7), py = block_top + (lane >> 3);
        light[l] = 1.0f;
        // weights: 1 - light, without the rounding of 1, which a faint pixel's depth would show
        depth[l] = weights[l] = median[l] = 0.0f;
        taken_to[l] = first;
        for (int d = 0; d < channels; ++d) color[l][d] = 0.0f;
        if (px < width && py < height) {
            const int index = (camera * height + py) * width + px;
            if (masks.shape[0] == 0 || masks.data[index]) open |= 1u << lane;
        }
    }
    unsigned any_open = ballot(open);

    for (int start = first; start < last; start += batch) {
        // The batch before was read before the last barrier of its turn.
        if (thread < batch) {
            float record[7 + channels];
            fetch_record(start + thread, last, record);
            store_record(thread, record);
        }
        WP_TILE_SYNC();  // records are whole
        if (runs) {
            for (int part = 0; part < batch && any_open; part += 32) {
                unsigned met = 0;
                for (int l = 0; l < lanes; ++l)
                    if (part + first_lane + l < batch && meets(part + first_lane + l)) met |= 1u << (first_lane + l);
                for (met = ballot(met); met; met &= met - 1) {
                    const int k = part + lowest(met);
                    const float* const record = records + k * stride;
                    for (int l = 0; l < lanes; ++l) {
                        const int lane = first_lane + l;
                        const float dx = (float)(block_left + (lane & 7)) + 0.5f - record[0];
                        const float dy = (float)(block_top + (lane >> 3)) + 0.5f - record[1];
                        const float alpha = wp::min(alpha_max, opacity_at(record, dx, dy));
                        if (!(open >> lane & 1u) || !(alpha >= alpha_min)) continue;
                        const float behind = light[l] * (1.0f - alpha);
                        if (behind <= light_min) {
                            open &= ~(1u << lane);
                            continue;
                        }
                        const float weight = alpha * light[l];
                        for (int d = 0; d < channels; ++d) color[l][d] += weight * record[7 + d];
                        depth[l] += weight * record[6];
                        weights[l] += weight;
                        if (light[l] > 0.5f && behind <= 0.5f) median[l] = record[6];
                        light[l] = behind;
                        taken_to[l] = start + k + 1;
                    }
                }
                any_open = ballot(open);
            }
            if (first_lane == 0) warp_open[warp] = any_open != 0;
        }
        WP_TILE_SYNC();  // records may go; every warp has said whether it is open, and says so again after the next one
        int more = 0;
        for (int w = 0; w < 8; ++w) more |= warp_open[w];
        if (!more) break;  // the same for all threads
    }

    if (runs) {
        for (int l = 0; l < lanes; ++l) {
            const int lane = first_lane + l, px = block_left + (lane & 7), py = block_top + (lane >> 3);
            if (px >= width || py >= height) continue;
            const int index = (camera * height + py) * width + px;
            for (int d = 0; d < channels; ++d) {
                render_colors.data[index][d] = color[l][d] + light[l] * backgrounds.data[camera][d];
                color_sums.data[index][d] = color[l][d];
            }
            render_alphas.data[index] = 1.0f - light[l];
            render_depths.data[index] = weights[l] > 0.0f ? depth[l] / weights[l] : 0.0f;
            if (median_depths.shape[0] > 0) median_depths.data[index] = median[l];
        }
        int stop = taken_to[0];
        for (int l = 1; l < lanes; ++l) stop = wp::max(stop, taken_to[l]);
    #if defined(__CUDA_ARCH__)
        for (int step = 16; step > 0; step >>= 1) stop = max(stop, __shfl_xor_sync(0xffffffffu, stop, step));
    #endif
        if (first_lane == 0) warp_stop[warp] = stop;
    }
    WP_TILE_SYNC();  // every warp has written its stop
    if (thread == 0) {
        int stop = first;
        for (int w = 0; w < 8; ++w) stop = wp::max(stop, warp_stop[w]);
        tile_stops.data[tile] = stop;
    }
"""


@cache
def gpu_forward_kernel(channels: int):
    vecD = wp.types.vector(channels, wp.float32)

    @wp.func_native(warps(channels, BATCH if channels <= 5 else 32) + _BLEND)
    def blend(
        thread: int,
        tile: int,
        camera: int,
        left: int,  # [px] of the tile
        top: int,
        first: int,  # intersection
        last: int,  # past it
        means2d: wp.array[wp.vec2],
        conics: wp.array[wp.vec3],
        depths: wp.array[float],
        opacities: wp.array[float],
        colors: wp.array(dtype=vecD),
        splat_ids: wp.array[int],
        width: int,
        height: int,
        backgrounds: wp.array(dtype=vecD),
        masks: wp.array[wp.uint8],
        render_colors: wp.array(dtype=vecD),
        render_alphas: wp.array[float],
        render_depths: wp.array[float],
        median_depths: wp.array[float],
        color_sums: wp.array(dtype=vecD),
        tile_stops: wp.array[int],
    ):
        """Blend a tile's splats; every thread of the block calls it."""

    @wp.kernel(
        enable_backward=False,
        module="unique",
        grid_stride=False,
        launch_bounds=(THREADS, 5 if channels <= 3 else 1),  # 48 registers are enough for three channels
    )
    def gpu_forward(
        # Splats, [C * N]
        means2d: wp.array[wp.vec2],
        conics: wp.array[wp.vec3],
        depths: wp.array[float],
        opacities: wp.array[float],
        colors: wp.array(dtype=vecD),
        # Tiles
        splat_ids: wp.array[int],  # [I]
        tile_ranges: wp.array[wp.vec2i],  # [C * tiles]
        # Frame
        width: int,
        height: int,
        backgrounds: wp.array(dtype=vecD),  # [C]
        masks: wp.array[wp.uint8],  # [C * H * W], or empty
        # Out, [C * H * W]
        render_colors: wp.array(dtype=vecD),
        render_alphas: wp.array[float],
        render_depths: wp.array[float],
        median_depths: wp.array[float],  # or empty
        color_sums: wp.array(dtype=vecD),  # sum of w * color, without background
        # Out
        tile_stops: wp.array[int],  # [C * tiles] past the last intersection that a pixel took
    ):
        tile, thread = wp.tid()
        camera, left, top = tile_corner(tile, width, height)
        span = tile_ranges[tile]
        blend(
            thread,
            tile,
            camera,
            left,
            top,
            span[0],
            span[1],
            means2d,
            conics,
            depths,
            opacities,
            colors,
            splat_ids,
            width,
            height,
            backgrounds,
            masks,
            render_colors,
            render_alphas,
            render_depths,
            median_depths,
            color_sums,
            tile_stops,
        )

    return gpu_forward
