"""Compositing on the CPU, backward: a thread per tile writes a row per intersection, a thread per splat adds them."""

from functools import cache

import warp as wp

from graphgs.kernels.cpu_flags import VECTOR_OPTIONS
from graphgs.kernels.rasterize.constants import TILE_SIZE
from graphgs.kernels.rasterize.lanes import lanes, record_size

# Sums over pixels that a row holds: of s = dL/dsigma, s dx, s dy, s dx dx, s dx dy, s dy dy; of w times the cotangents
# of colours and depth; and, for absolute gradients, of |dL/dmean2d|
MOMENTS = 6


def row_size(channels: int, absolute: bool) -> int:
    """Floats per row."""
    return MOMENTS + channels + 1 + 2 * int(absolute)


def _fold(results: int, group: int) -> str:
    """Two vectors in groups of lanes become one: the halves of each group are added."""
    lower = ", ".join(str(lane) for lane in range(32) if lane % group < group // 2)
    upper = ", ".join(str(lane) for lane in range(32) if lane % group >= group // 2)
    pair = "v[2 * k], v[2 * k + 1]"
    halves = [f"__builtin_shufflevector({pair}, {lanes})" for lanes in (lower, upper)]
    return f"for (int k = 0; k < {results}; ++k) v[k] = {' + '.join(halves)};"


# The sums over lanes of 16 vectors, as the lanes of one
_SUM_LANES = f"""
    auto sum_lanes = [](lanes* v) -> lanes {{
        {_fold(8, 16)}
        {_fold(4, 8)}
        {_fold(2, 4)}
        {_fold(1, 2)}
        return v[0];
    }};
"""

_UNBLEND = """
    // Of a block: cotangents of the sums of w * colour, w * depth and w; light; the loss still behind; of median depth
    constexpr int v_depth_at = channels, v_weight_at = channels + 1;
    constexpr int light_at = channels + 2, remaining_at = channels + 3;
    constexpr int planes = channels + 4 + median;
    constexpr int sums = 6 + channels + 1 + 2 * absolute, groups = (sums + 15) / 16;
    const float x = left + 0.5f, y = top + 0.5f;
    const long image = (long)camera * height * width;
    const float* colors = (const float*)render_colors.data;
    const float* v_colors = (const float*)v_render_colors.data;
    const float* background = (const float*)backgrounds.data + (long)channels * camera;
    float* rows = splat_sums.data;

    alignas(64) lanes state[16 * planes];
    for (int block = 0; block < 16; ++block) {
        float* plane = (float*)(state + planes * block);
        for (int k = 0; k < 16 * planes; ++k) plane[k] = 0.0f;
        for (int k = 0; k < 16; ++k) {
            const int px = left + 4 * (block & 3) + (k & 3), py = top + 4 * (block >> 2) + (k >> 2);
            const long index = image + (long)py * width + px;
            plane[16 * light_at + k] = -1.0f;
            if (px >= width || py >= height || !(render_alphas.data[index] > 0.0f)) continue;
            const float alpha = render_alphas.data[index], depth = render_depths.data[index];
            const float v_depth = v_render_depths.data[index] / alpha;
            // The depth, being an average, has no part in the loss behind at the start.
            float v_light = v_render_alphas.data[index], remaining = 0.0f;
            for (int c = 0; c < channels; ++c) {
                const float v_color = v_colors[channels * index + c];
                plane[16 * c + k] = v_color;
                v_light -= v_color * background[c];
                remaining += v_color * (colors[channels * index + c] - (1.0f - alpha) * background[c]);
            }
            plane[16 * v_depth_at + k] = v_depth;
            plane[16 * v_weight_at + k] = v_light - v_depth * depth;
            plane[16 * light_at + k] = 1.0f;
            plane[16 * remaining_at + k] = remaining + v_light * alpha;
            if (median) plane[16 * (remaining_at + median) + k] = v_render_medians.data[index];
        }
    }

    const unsigned* lists = taken.data + 16l * (begin / 32 + tile);
    for (int at = begin; at < stop; at += 32, lists += 16) {
        const int count = stop - at < 32 ? stop - at : 32;
        unsigned any = 0;
        for (int block = 0; block < 16; ++block) any |= lists[block];
        alignas(64) float params[32 * (param_size + 1)];
        alignas(64) lanes totals[32 * sums];
        for (unsigned left_to_do = any; left_to_do; left_to_do &= left_to_do - 1) {
            const int j = __builtin_ctz(left_to_do);
            set_params(records.data + (long)ranks.data[at + j] * record_size, x, y, params + (param_size + 1) * j);
            for (int k = 0; k < sums; ++k) totals[sums * j + k] = zero;
        }
        for (int block = 0; block < 16; ++block) {
            unsigned list = lists[block];
            if (!list) continue;
            const lanes px = column + 4.0f * (block & 3), py = row + 4.0f * (block >> 2);
            lanes* plane = state + planes * block;
            lanes light = plane[light_at], remaining = plane[remaining_at];
            lanes v_sums[channels + 2];
            #pragma unroll
            for (int k = 0; k < channels + 2; ++k) v_sums[k] = plane[k];
            for (; list; list &= list - 1) {
                const int j = __builtin_ctz(list);
                const float* p = params + (param_size + 1) * j;
                lanes* total = totals + sums * j;
                const lanes dx = px + p[0], dy = py + p[1];
                const lanes raw = power_of_two((p[2] * dx + p[3] * dy) * dx + (p[4] * dy * dy + p[5]));
                lanes alpha = raw < alpha_max ? raw : (lanes)alpha_max;
                alpha = alpha < alpha_min ? zero : alpha;
                const lanes absorbed = alpha * light;
                const lanes behind = light - absorbed;
                const bits goes_on = behind > light_min;
                const lanes weight = goes_on ? absorbed : zero;
                lanes gain = v_sums[v_weight_at];
                #pragma unroll
                for (int k = 0; k <= channels; ++k) gain += v_sums[k] * p[6 + k];
                const lanes weighted = weight * gain;
                remaining -= weighted;
                lanes v_sigma = alpha * inverse(1.0f - alpha) * remaining - weighted;
                v_sigma = ((weight > 0.0f) & (raw <= alpha_max)) ? v_sigma : zero;  // the clamp has no gradient
                const lanes v_x = v_sigma * dx, v_y = v_sigma * dy;
                total[0] += v_sigma;
                total[1] += v_x;
                total[2] += v_y;
                total[3] += v_x * dx;
                total[4] += v_x * dy;
                total[5] += v_y * dy;
                #pragma unroll
                for (int k = 0; k <= channels; ++k) total[6 + k] += weight * v_sums[k];
                if (median) {
                    const bits halves = (light > 0.5f) & goes_on & (behind <= 0.5f);
                    total[6 + channels] += halves ? plane[remaining_at + median] : zero;
                }
                if (absolute) {  // p2 and p4 hold half of the conic's diagonal, all times -log2 e
                    constexpr float ln_2 = 0.69314718f;
                    const lanes toward_x = 2.0f * p[2] * v_x + p[3] * v_y, toward_y = p[3] * v_x + 2.0f * p[4] * v_y;
                    total[7 + channels] += __builtin_elementwise_abs(ln_2 * toward_x);
                    total[8 + channels] += __builtin_elementwise_abs(ln_2 * toward_y);
                }
                light = goes_on ? behind : -__builtin_elementwise_abs(light);
            }
            plane[light_at] = light;
            plane[remaining_at] = remaining;
        }
        for (int j = 0; j < count; ++j) {
            float* out = rows + (long)sums * slots.data[at + j];
            if (!(any >> j & 1)) {
                for (int k = 0; k < sums; ++k) out[k] = 0.0f;
                continue;
            }
            #pragma unroll
            for (int group = 0; group < groups; ++group) {
                lanes v[16];
                #pragma unroll
                for (int k = 0; k < 16; ++k) v[k] = 16 * group + k < sums ? totals[sums * j + 16 * group + k] : zero;
                const lanes folded = sum_lanes(v);
                __builtin_memcpy(out + 16 * group, &folded, 4 * (sums - 16 * group < 16 ? sums - 16 * group : 16));
            }
        }
    }
    for (int at = stop; at < end; ++at) {
        float* out = rows + (long)sums * slots.data[at];
        for (int k = 0; k < sums; ++k) out[k] = 0.0f;
    }
"""

_INVERSE = """
    // 1 / x, relative error below 1e-7 on [0.01, 1]
    auto inverse = [](lanes x) -> lanes {
    #ifdef __AVX512F__  // a division blocks the port that half of all other work goes through
        const lanes guess = __builtin_ia32_rcp14ps512_mask(x, (lanes)0.0f, (unsigned short)-1);
        return guess * (2.0f - x * guess);
    #else
        return 1.0f / x;
    #endif
    };
"""


@cache
def unblend_tile_kernel(channels: int, median: bool, absolute: bool):
    vec = wp.types.vector(channels, wp.float32)
    flags = f"constexpr int median = {int(median)}, absolute = {int(absolute)};"

    @wp.func_native(lanes(channels) + flags + _INVERSE + _SUM_LANES + _UNBLEND)
    def unblend(
        records: wp.array[float],
        ranks: wp.array[int],
        slots: wp.array[int],
        begin: int,
        stop: int,
        end: int,
        tile: int,
        camera: int,
        left: int,  # [px] of the tile's first pixel
        top: int,
        width: int,
        height: int,
        backgrounds: wp.array(dtype=vec),
        taken: wp.array[wp.uint32],
        render_colors: wp.array(dtype=vec),
        render_alphas: wp.array[float],
        render_depths: wp.array[float],
        v_render_colors: wp.array(dtype=vec),
        v_render_alphas: wp.array[float],
        v_render_depths: wp.array[float],
        v_render_medians: wp.array[float],
        splat_sums: wp.array[float],
    ):
        """The adjoint of `blend`, in the same order, front to back (docs/kernels.md derives it)."""

    @wp.kernel(enable_backward=False, module="unique", module_options=VECTOR_OPTIONS)
    def unblend_tile(
        first: int,
        # Splats
        records: wp.array[float],  # [M * record_size]
        ranks: wp.array[int],  # [I]
        slots: wp.array[int],  # [I]
        tile_starts: wp.array[int],  # [C * tiles + 1]
        tile_stops: wp.array[int],  # [C * tiles]
        taken: wp.array[wp.uint32],  # [batches * BLOCKS]
        # Frame
        width: int,
        height: int,
        backgrounds: wp.array(dtype=vec),  # [C]
        # Rendered, and cotangents, [C * H * W]
        render_colors: wp.array(dtype=vec),
        render_alphas: wp.array[float],
        render_depths: wp.array[float],
        v_render_colors: wp.array(dtype=vec),
        v_render_alphas: wp.array[float],
        v_render_depths: wp.array[float],
        v_render_medians: wp.array[float],  # or empty
        # Out
        splat_sums: wp.array[float],  # [I * row_size] by slot
    ):
        tile = first + wp.tid()
        columns = (width + TILE_SIZE - 1) // TILE_SIZE
        rows = (height + TILE_SIZE - 1) // TILE_SIZE
        unblend(
            records,
            ranks,
            slots,
            tile_starts[tile],
            tile_stops[tile],
            tile_starts[tile + 1],
            tile,
            tile // (rows * columns),
            (tile % columns) * TILE_SIZE,
            ((tile // columns) % rows) * TILE_SIZE,
            width,
            height,
            backgrounds,
            taken,
            render_colors,
            render_alphas,
            render_depths,
            v_render_colors,
            v_render_alphas,
            v_render_depths,
            v_render_medians,
            splat_sums,
        )

    return unblend_tile


@cache
def gather_splat_kernel(channels: int, absolute: bool):
    vec = wp.types.vector(channels, wp.float32)
    size, record = row_size(channels, absolute), record_size(channels)
    sums = wp.types.vector(size, wp.float32)

    @wp.func_native(
        f"""
        typedef float row __attribute__((ext_vector_type({size}), aligned(4)));
        row total = 0.0f;
        for (int slot = begin; slot < end; ++slot) {{
            const float* s = splat_sums.data + {size}l * slot;
            row values;
            __builtin_memcpy(&values, s, 4 * {size});
            total += values;
        }}
        wp::vec_t<{size}, float> result;
        for (int k = 0; k < {size}; ++k) result[k] = total[k];
        return result;
        """
    )
    def sum_rows(splat_sums: wp.array[float], begin: int, end: int) -> sums:
        """The sum of the rows begin .. end - 1, in that order."""

    @wp.kernel(enable_backward=False, module="unique", module_options=VECTOR_OPTIONS)
    def gather_splat(
        first: int,
        splat_ids: wp.array[int],  # [M]
        slot_starts: wp.array[int],  # [M + 1]
        records: wp.array[float],  # [M * record_size]
        splat_sums: wp.array[float],  # [I * row_size]
        opacities: wp.array[float],  # [C * N]
        # Out, [C * N], zero before
        v_means2d: wp.array[wp.vec2],
        v_conics: wp.array[wp.vec3],
        v_depths: wp.array[float],
        v_opacities: wp.array[float],
        v_colors: wp.array(dtype=vec),
        abs_means2d: wp.array[wp.vec2],  # or empty
    ):
        rank = first + wp.tid()
        s = splat_ids[rank]
        total = sum_rows(splat_sums, slot_starts[rank], slot_starts[rank + 1])
        at = rank * record
        a, b, c = records[at + 2], records[at + 3], records[at + 4]
        # sigma = (a dx^2 + c dy^2) / 2 + b dx dy, with dx = pixel - mean; alpha = opacity * exp(-sigma)
        v_means2d[s] = -wp.vec2(a * total[1] + b * total[2], b * total[1] + c * total[2])
        v_conics[s] = wp.vec3(0.5 * total[3], total[4], 0.5 * total[5])
        v_opacities[s] = -total[0] / opacities[s]
        v_color = vec()
        for k in range(channels):
            v_color[k] = total[MOMENTS + k]
        v_colors[s] = v_color
        v_depths[s] = total[MOMENTS + channels]
        if wp.static(absolute):
            abs_means2d[s] = wp.vec2(total[MOMENTS + channels + 1], total[MOMENTS + channels + 2])

    return gather_splat
