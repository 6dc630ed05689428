"""Compositing on a GPU, backward: a block per tile, a warp per 8 x 4 pixels, and two turns for every eight splats.

First a lane is a pixel: it walks the splats that meet its warp, front to back, and leaves two numbers for each, the
gradient of sigma and the weight. After eight splats the table is turned round: a lane is a splat and one of the four
rows of pixels, and adds up its eight pixels in registers. A sum over 32 lanes would take five shuffles for each of ten
sums and each splat; so it takes two for each sum and eight splats.

What a pixel carries along, its light and what still lies behind (docs/kernels.md), stays in registers. The rows that
the 8 warps found for a splat are added in their order and written to the intersection's slot, and at the end the slots
of a splat are added (gpu_gather.py): no atomics, the same bits every time.
"""

from functools import cache

import warp as wp

from graphgs.kernels.rasterize.gpu_forward import tile_corner
from graphgs.kernels.rasterize.warps import THREADS, warps

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

COLOR = 7  # where the colour begins among the sums
ROW_BYTES = 9_216  # of shared memory for the rows of a batch: three blocks then fit an SM of sm_86


def row_size(channels: int, absolute: bool) -> int:
    """Numbers per intersection, summed over pixels: with s = dL/dsigma, s, s dx, s dy, s dx^2, s dx dy, s dy^2;
    v_depth; v_color; and if `absolute` the two of |share of v_mean2d|."""
    return COLOR + channels + (2 if absolute else 0)


def _unblend(channels: int, absolute: bool) -> str:
    row = row_size(channels, absolute)
    batch = max(8, min(32, ROW_BYTES // (8 * 4 * row) // 8 * 8))
    near = channels <= 3  # colours' cotangents are kept in shared memory
    return f"""
    {warps(channels, batch)}
    constexpr int row = {row}, held_most = 8;
    constexpr bool absolute = {int(absolute)}, near = {int(near)};
    constexpr int pixel_stride = {4 if near else 1};
    {_BODY}
    """


_BODY = """
    struct alignas(8) Share { float v_sigma, weight; };
    alignas(16) WARP_SHARED float pixels[256 * pixel_stride];  // cotangents of colour (if near) and depth
    alignas(16) WARP_SHARED Share shares[8][held_most * 32];  // by warp, splat and pixel
    WARP_SHARED float rows[8][batch * row];  // by warp and splat
    WARP_SHARED int batch_slots[2][batch];
    WARP_SHARED unsigned warp_kept[8];

    const bool has_median = v_median_depths.shape[0] > 0;
    float light[lanes], rest[lanes], v_weight[lanes], v_z[lanes], v_color[lanes][channels];
    unsigned open = 0;
    if (runs) {
        for (int l = 0; l < lanes; ++l) {
            const int lane = first_lane + l, px = block_left + (lane & 7), py = block_top + (lane >> 3);
            light[l] = rest[l] = v_weight[l] = v_z[l] = 0.0f;
            for (int d = 0; d < channels; ++d) v_color[l][d] = 0.0f;
            const int index = (camera * height + py) * width + px;
            const float alpha_sum = px < width && py < height ? render_alphas.data[index] : 0.0f;
            if (alpha_sum > 0.0f) {
                const float v_depth = v_depths.shape[0] > 0 ? v_depths.data[index] : 0.0f;
                v_z[l] = v_depth / alpha_sum;
                float v_light = v_alphas.shape[0] > 0 ? v_alphas.data[index] : 0.0f;
                for (int d = 0; d < channels; ++d) {
                    v_color[l][d] = v_colors.data[index][d];
                    v_light -= v_color[l][d] * backgrounds.data[camera][d];
                }
                rest[l] = v_light * alpha_sum;
                for (int d = 0; d < channels; ++d) rest[l] += v_color[l][d] * color_sums.data[index][d];
                v_weight[l] = v_light - v_z[l] * render_depths.data[index];
                light[l] = 1.0f;
                open |= 1u << lane;
            }
            float* const pixel = pixels + (thread + l) * pixel_stride;  // read by this warp alone, in `add_up`
            if (near) for (int d = 0; d < channels; ++d) pixel[d] = v_color[l][d];
            pixel[pixel_stride - 1] = v_z[l];
        }
    }
    unsigned any_open = ballot(open);

    // Turn the table round: a lane is one of eight splats and a row of eight pixels.
    auto add_up = [&](int held, unsigned long long splats) {  // a byte for each: its place in the batch
        sync_warp();  // the lanes have written the shares of their pixels; each now reads those of others
        float sums[lanes][row];
        for (int l = 0; l < lanes; ++l) {
            const int lane = first_lane + l, h = lane & 7, line = lane >> 3;
            const float* const record = records + (int)(splats >> (8 * h) & 31u) * stride;
            const float x = (float)block_left + 0.5f - record[0], dy = (float)(block_top + line) + 0.5f - record[1];
            float s = 0.0f, s_x = 0.0f, s_xx = 0.0f, depth = 0.0f, color[channels], abs_x = 0.0f, abs_y = 0.0f;
            for (int d = 0; d < channels; ++d) color[d] = 0.0f;
            WP_PRAGMA_UNROLL
            for (int j = 0; j < 8; ++j) {
                const int place = line * 8 + j;
                const Share share = shares[warp][h * 32 + (place ^ h)];
                const float* const pixel = pixels + (warp * 32 + place) * pixel_stride;
                const float dx = x + (float)j, moment = share.v_sigma * dx;
                s += share.v_sigma;
                s_x += moment;
                s_xx += moment * dx;
                depth += share.weight * pixel[pixel_stride - 1];
                if (near) {
                    for (int d = 0; d < channels; ++d) color[d] += share.weight * pixel[d];
                } else {  // from global memory; outside the image the weight is 0
                    const int px = wp::min(block_left + j, width - 1), py = wp::min(block_top + line, height - 1);
                    const int index = (camera * height + py) * width + px;
                    for (int d = 0; d < channels; ++d) color[d] += share.weight * v_colors.data[index][d];
                }
                if (absolute) {  // record[2..4] = -log2(e) (a / 2, b, c / 2) of the conic
                    constexpr float ln_2 = 0.693147181f;
                    const float v_dy = share.v_sigma * dy;
                    abs_x += ln_2 * wp::abs(2.0f * record[2] * moment + record[3] * v_dy);
                    abs_y += ln_2 * wp::abs(record[3] * moment + 2.0f * record[4] * v_dy);
                }
            }
            sums[l][0] = s;
            sums[l][1] = s_x;
            sums[l][2] = s * dy;
            sums[l][3] = s_xx;
            sums[l][4] = s_x * dy;
            sums[l][5] = s * dy * dy;
            sums[l][6] = depth;
            for (int d = 0; d < channels; ++d) sums[l][7 + d] = color[d];
            if (absolute) {
                sums[l][row - 2] = abs_x;
                sums[l][row - 1] = abs_y;
            }
        }
        for (int c = 0; c < row; ++c) {  // over the four rows of pixels
    #if defined(__CUDA_ARCH__)
            sums[0][c] += __shfl_xor_sync(0xffffffffu, sums[0][c], 8);
            sums[0][c] += __shfl_xor_sync(0xffffffffu, sums[0][c], 16);
    #else
            for (int l = 0; l < 8; ++l)
                sums[l][c] = (sums[l][c] + sums[l + 8][c]) + (sums[l + 16][c] + sums[l + 24][c]);
    #endif
        }
        for (int l = 0; l < lanes && first_lane + l < held; ++l) {
            float* const to = rows[warp] + (int)(splats >> (8 * (first_lane + l)) & 31u) * row;
            if (has_median) sums[l][6] += to[6];
            for (int c = 0; c < row; ++c) to[c] = sums[l][c];
        }
        sync_warp();  // the table was read, the next splats may fill it
    };

    float record[7 + channels];
    if (thread < batch) {
        fetch_record(first + thread, stop, record);
        store_record(thread, record);
        batch_slots[0][thread] = first + thread < stop ? slots.data[first + thread] : 0;
    }
    int turn = 0;
    for (int start = first; start < stop; start += batch, turn ^= 1) {
        WP_TILE_SYNC();  // this batch's records are whole, and the rows of the one before were read
        if (runs) {
            unsigned met = 0, kept = 0;
            int held = 0;
            unsigned long long splats = 0;
            if (any_open)
                for (int l = 0; l < lanes; ++l)
                    if (first_lane + l < batch && meets(first_lane + l)) met |= 1u << (first_lane + l);
            for (met = ballot(met); met; met &= met - 1) {
                const int k = lowest(met);
                const float* const record = records + k * stride;
                float v_sigma[lanes], weight[lanes];
                unsigned took = 0, halved = 0;
                for (int l = 0; l < lanes; ++l) {
                    const int lane = first_lane + l;
                    const float dx = (float)(block_left + (lane & 7)) + 0.5f - record[0];
                    const float dy = (float)(block_top + (lane >> 3)) + 0.5f - record[1];
                    const float opacity = opacity_at(record, dx, dy), alpha = wp::min(alpha_max, opacity);
                    v_sigma[l] = weight[l] = 0.0f;
                    if (!(light[l] > 0.0f) || !(alpha >= alpha_min)) continue;
                    const float through = 1.0f - alpha, behind = light[l] * through;
                    if (behind <= light_min) {
                        light[l] = 0.0f;  // closed: it sees no further splat
                        continue;
                    }
                    took |= 1u << lane;
                    if (light[l] > 0.5f && behind <= 0.5f) halved |= 1u << lane;
                    weight[l] = alpha * light[l];
                    float gain = v_weight[l] + v_z[l] * record[6];
                    for (int d = 0; d < channels; ++d) gain += v_color[l][d] * record[7 + d];
                    const float gained = weight[l] * gain;
                    rest[l] -= gained;
                    light[l] = behind;
                    const float odds = divide(alpha, through);
                    if (opacity <= alpha_max) v_sigma[l] = odds * rest[l] - gained;  // the clamp has no gradient
                }
                if (!ballot(took)) continue;
                for (int l = 0; l < lanes; ++l)
                    shares[warp][held * 32 + ((first_lane + l) ^ held)] = Share { v_sigma[l], weight[l] };
                if (has_median) {  // at most once per pixel
                    float v_median = 0.0f;
                    if (ballot(halved)) {
                        for (int l = 0; l < lanes; ++l) {
                            const int lane = first_lane + l, px = block_left + (lane & 7), py = block_top + (lane >> 3);
                            if (halved >> lane & 1u)
                                v_median += v_median_depths.data[(camera * height + py) * width + px];
                        }
    #if defined(__CUDA_ARCH__)
                        for (int step = 16; step > 0; step >>= 1)
                            v_median += __shfl_xor_sync(0xffffffffu, v_median, step);
    #endif
                    }
                    if (first_lane == 0) rows[warp][k * row + 6] = v_median;  // read and overwritten in `add_up`
                }
                splats |= (unsigned long long)k << (8 * held);
                kept |= 1u << k;
                if (++held == held_most) {
                    add_up(held, splats);
                    held = 0;
                    splats = 0;
                }
            }
            if (held > 0) add_up(held, splats);
            open = 0;
            for (int l = 0; l < lanes; ++l) open |= (unsigned)(light[l] > 0.0f) << (first_lane + l);
            any_open = ballot(open);
            if (first_lane == 0) warp_kept[warp] = kept;
        }
        WP_TILE_SYNC();  // rows are whole; records may go
        const int next = start + batch + thread;
        if (thread < batch) fetch_record(next, stop, record);  // arrives while rows are added up
        for (int at = thread; at < batch * row; at += 256) {
            const int k = at / row;
            if (start + k >= stop) break;
            float total = 0.0f;
            for (int w = 0; w < 8; ++w)
                if (warp_kept[w] >> k & 1u) total += rows[w][at];
            splat_sums.data[(long long)batch_slots[turn][k] * row + (at - k * row)] = total;
        }
        if (thread < batch) {
            store_record(thread, record);
            batch_slots[turn ^ 1][thread] = next < stop ? slots.data[next] : 0;  // the other half is being read
        }
    }
    // What no pixel took.
    for (int at = thread; at < (last - stop) * row; at += 256)
        splat_sums.data[(long long)slots.data[stop + at / row] * row + at % row] = 0.0f;
"""


@cache
def gpu_backward_kernel(channels: int, absolute: bool):
    # Registers: 64 are enough for three channels, 80 with `absolute`, 128 for eight channels.
    resident = (3 if absolute else 4) if channels <= 3 else 2 if channels <= 8 else 1  # blocks of an SM
    vecD = wp.types.vector(channels, wp.float32)

    @wp.func_native(_unblend(channels, absolute))
    def unblend(
        thread: int,
        camera: int,
        left: int,  # [px] of the tile
        top: int,
        first: int,  # intersection
        stop: int,  # past the last that a pixel took
        last: int,  # past the tile's last
        means2d: wp.array[wp.vec2],
        conics: wp.array[wp.vec3],
        depths: wp.array[float],
        opacities: wp.array[float],
        colors: wp.array(dtype=vecD),
        splat_ids: wp.array[int],
        slots: wp.array[int],
        width: int,
        height: int,
        backgrounds: wp.array(dtype=vecD),
        render_alphas: wp.array[float],
        render_depths: wp.array[float],
        color_sums: wp.array(dtype=vecD),
        v_colors: wp.array(dtype=vecD),
        v_alphas: wp.array[float],
        v_depths: wp.array[float],
        v_median_depths: wp.array[float],
        splat_sums: wp.array[float],
    ):
        """The sums of a tile's splats; every thread of the block calls it."""

    @wp.kernel(
        enable_backward=False,
        module="unique",
        grid_stride=False,
        launch_bounds=(THREADS, resident),
    )
    def gpu_backward(
        # Splats, [C * N]
        means2d: wp.array[wp.vec2],
        conics: wp.array[wp.vec3],
        depths: wp.array[float],
        opacities: wp.array[float],
        colors: wp.array(dtype=vecD),
        # Tiles
        splat_ids: wp.array[int],  # [I]
        slots: wp.array[int],  # [I]
        tile_ranges: wp.array[wp.vec2i],  # [C * tiles]
        tile_stops: wp.array[int],  # [C * tiles]
        # Frame
        width: int,
        height: int,
        backgrounds: wp.array(dtype=vecD),  # [C]
        # Rendered, and cotangents, [C * H * W]
        render_alphas: wp.array[float],
        render_depths: wp.array[float],
        color_sums: wp.array(dtype=vecD),
        v_colors: wp.array(dtype=vecD),
        v_alphas: wp.array[float],  # or empty: 0
        v_depths: wp.array[float],  # or empty: 0
        v_median_depths: wp.array[float],  # or empty
        # Out
        splat_sums: wp.array[float],  # [I * row_size] by slot
    ):
        tile, thread = wp.tid()
        camera, left, top = tile_corner(tile, width, height)
        unblend(
            thread,
            camera,
            left,
            top,
            tile_ranges[tile][0],
            tile_stops[tile],
            tile_ranges[tile][1],
            means2d,
            conics,
            depths,
            opacities,
            colors,
            splat_ids,
            slots,
            width,
            height,
            backgrounds,
            render_alphas,
            render_depths,
            color_sums,
            v_colors,
            v_alphas,
            v_depths,
            v_median_depths,
            splat_sums,
        )

    return gpu_backward
