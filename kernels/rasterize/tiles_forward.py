"""Compositing on the CPU, forward: one thread per tile; batches of splats, then blocks of 16 pixels, then splats."""

from functools import cache

import warp as wp

from graphgs.kernels.cpu_flags import VECTOR_OPTIONS
from graphgs.kernels.rasterize.constants import TILE_SIZE
from graphgs.kernels.rasterize.lanes import ELLIPSE, lanes

# A bit for each of the 16 blocks that the ellipse of a record meets: `band_extent` of ellipse.py for the four rows of
# blocks at once
_TOUCHED = f"""
    typedef float four __attribute__((ext_vector_type(4)));
    typedef int ints __attribute__((ext_vector_type(4)));
    auto touched_blocks = [](const float* s, float x, float y) -> int {{
        auto larger = [](four a, four b) -> four {{ return a > b ? a : b; }};
        auto smaller = [](four a, four b) -> four {{ return a < b ? a : b; }};
        const float slope = s[{ELLIPSE}], height = s[{ELLIPSE} + 1], right_y = s[{ELLIPSE} + 2];
        const float flatness = s[{ELLIPSE} + 3], width = s[{ELLIPSE} + 4];
        const four band = {{0, 4, 8, 12}}, none = 0.0f;
        const four top = y - s[1] + band;
        const four lo = larger(top, (four)-height), hi = smaller(top + 3.0f, (four)height);
        const four at_left = smaller(larger((four)-right_y, lo), hi);
        const four at_right = smaller(larger((four)right_y, lo), hi);
        const four left_chord = __builtin_elementwise_sqrt(larger(width - flatness * at_left * at_left, none));
        const four right_chord = __builtin_elementwise_sqrt(larger(width - flatness * at_right * at_right, none));
        const four from_x = s[0] - x - slope * at_left - left_chord;
        const four to_x = s[0] - x - slope * at_right + right_chord;
        const four first_x = __builtin_elementwise_ceil(smaller(larger(from_x, none), (four)16.0f));
        const four last_x = __builtin_elementwise_floor(smaller(larger(to_x, (four)-1.0f), (four)15.0f));
        const ints first = __builtin_convertvector(first_x, ints) >> 2;
        const ints past = (__builtin_convertvector(last_x, ints) >> 2) + 1;
        const ints row_bits = ((ints)1 << past) - ((ints)1 << first);
        const ints shifts = {{0, 4, 8, 12}};
        return __builtin_reduce_or(((lo <= hi) & (first < past) & row_bits) << shifts);
    }};
"""

_BLEND = """
    // Of a block: sums of w * colour, w * depth and w (that is 1 - light, without the rounding of 1, which a faint
    // pixel's depth would show), light, median depth
    constexpr int weight_at = channels + 1, light_at = channels + 2, planes = channels + 3 + median;
    typedef int wide __attribute__((ext_vector_type(32)));
    typedef bool flags __attribute__((ext_vector_type(32)));
    const float x = left + 0.5f, y = top + 0.5f;
    const bool masked = masks.shape[0] > 0;
    const long image = (long)camera * height * width;

    // Light is the transmittance; negative once a pixel has stopped, or where there is no pixel.
    alignas(64) lanes state[16 * planes];
    unsigned open = 0;
    for (int block = 0; block < 16; ++block) {
        lanes* plane = state + planes * block;
        for (int k = 0; k < planes; ++k) plane[k] = zero;
        float* light = (float*)(plane + light_at);
        for (int k = 0; k < 16; ++k) {
            const int px = left + 4 * (block & 3) + (k & 3), py = top + 4 * (block >> 2) + (k >> 2);
            const bool seen = px < width && py < height && (!masked || masks.data[image + (long)py * width + px]);
            light[k] = seen ? 1.0f : -1.0f;
            open |= (unsigned)seen << block;
        }
    }

    int batch = begin / 32 + tile;
    int at = begin;
    for (; at < end && open; at += 32, ++batch) {
        const int count = end - at < 32 ? end - at : 32;
        alignas(64) float params[32 * (param_size + 1)];
        wide touched = 0;
        for (int j = 0; j < count; ++j) {
            const float* s = records.data + (long)ranks.data[at + j] * record_size;
            touched[j] = touched_blocks(s, x, y);
            set_params(s, x, y, params + (param_size + 1) * j);
        }
        unsigned* lists = taken.data + 16l * batch;
        for (int block = 0; block < 16; ++block) lists[block] = 0;
        for (unsigned blocks = open; blocks; blocks &= blocks - 1) {
            const int block = __builtin_ctz(blocks);
            const flags meets = __builtin_convertvector((touched & (1 << block)) != 0, flags);
            unsigned list = __builtin_bit_cast(unsigned, meets), took = 0;
            if (!list) continue;
            const lanes px = column + 4.0f * (block & 3), py = row + 4.0f * (block >> 2);
            lanes* plane = state + planes * block;
            lanes sums[channels + 1];
            #pragma unroll
            for (int k = 0; k <= channels; ++k) sums[k] = plane[k];
            lanes weights = plane[weight_at], light = plane[light_at], halved = zero;
            if (median) halved = plane[light_at + median];
            for (; list; list &= list - 1) {
                const int j = __builtin_ctz(list);
                const float* p = params + (param_size + 1) * j;
                const lanes dx = px + p[0], dy = py + p[1];
                lanes alpha = power_of_two((p[2] * dx + p[3] * dy) * dx + (p[4] * dy * dy + p[5]));
                alpha = alpha < alpha_max ? alpha : (lanes)alpha_max;
                alpha = alpha < alpha_min ? zero : alpha;
                const lanes absorbed = alpha * light;
                const lanes behind = light - absorbed;
                const bits goes_on = behind > light_min;
                const lanes weight = goes_on ? absorbed : zero;
                #pragma unroll
                for (int k = 0; k <= channels; ++k) sums[k] += weight * p[6 + k];
                weights += weight;
                if (median) halved = ((light > 0.5f) & goes_on & (behind <= 0.5f)) ? (lanes)p[6 + channels] : halved;
                light = goes_on ? behind : -__builtin_elementwise_abs(light);
                took |= (unsigned)(__builtin_reduce_or(weight > 0.0f) & 1) << j;
            }
            #pragma unroll
            for (int k = 0; k <= channels; ++k) plane[k] = sums[k];
            plane[weight_at] = weights;
            plane[light_at] = light;
            if (median) plane[light_at + median] = halved;
            lists[block] = took;
            if (!__builtin_reduce_or(light > 0.0f)) open &= ~(1u << block);
        }
    }

    float* colors = (float*)render_colors.data;
    const float* background = (const float*)backgrounds.data + (long)channels * camera;
    for (int block = 0; block < 16; ++block) {
        const float* plane = (const float*)(state + planes * block);
        for (int k = 0; k < 16; ++k) {
            const int px = left + 4 * (block & 3) + (k & 3), py = top + 4 * (block >> 2) + (k >> 2);
            if (px >= width || py >= height) continue;
            const long index = image + (long)py * width + px;
            const float light = __builtin_fabsf(plane[16 * light_at + k]), weight = plane[16 * weight_at + k];
            for (int c = 0; c < channels; ++c) colors[channels * index + c] = plane[16 * c + k] + light * background[c];
            render_alphas.data[index] = 1.0f - light;
            render_depths.data[index] = weight > 0.0f ? plane[16 * channels + k] / weight : 0.0f;
            if (median) render_medians.data[index] = plane[16 * (light_at + median) + k];
        }
    }
    return at < end ? at : end;
"""


@cache
def blend_tile_kernel(channels: int, median: bool):
    vec = wp.types.vector(channels, wp.float32)

    @wp.func_native(lanes(channels) + f"constexpr int median = {int(median)};" + _TOUCHED + _BLEND)
    def blend(
        records: wp.array[float],
        ranks: wp.array[int],
        begin: int,
        end: int,
        tile: int,
        camera: int,
        left: int,  # [px] of the tile's first pixel
        top: int,
        width: int,
        height: int,
        backgrounds: wp.array(dtype=vec),
        masks: wp.array[wp.uint8],
        render_colors: wp.array(dtype=vec),
        render_alphas: wp.array[float],
        render_depths: wp.array[float],
        render_medians: wp.array[float],
        taken: wp.array[wp.uint32],
    ) -> int:
        """Blend the splats begin .. end - 1 over one tile; past the last one that was looked at."""

    @wp.kernel(enable_backward=False, module="unique", module_options=VECTOR_OPTIONS)
    def blend_tile(
        first: int,
        # Splats
        records: wp.array[float],  # [M * record_size]
        ranks: wp.array[int],  # [I]
        tile_starts: wp.array[int],  # [C * tiles + 1]
        # Frame
        width: int,
        height: int,
        backgrounds: wp.array(dtype=vec),  # [C]
        masks: wp.array[wp.uint8],  # [C * H * W] or empty
        # Out
        render_colors: wp.array(dtype=vec),  # [C * H * W]
        render_alphas: wp.array[float],
        render_depths: wp.array[float],
        render_medians: wp.array[float],  # or empty
        taken: wp.array[
            wp.uint32
        ],  # [batches * BLOCKS] a bit for each splat of the batch that a pixel of the block took
        tile_stops: wp.array[int],  # [C * tiles] past the last splat that was looked at
    ):
        tile = first + wp.tid()
        columns = (width + TILE_SIZE - 1) // TILE_SIZE
        rows = (height + TILE_SIZE - 1) // TILE_SIZE
        tile_stops[tile] = blend(
            records,
            ranks,
            tile_starts[tile],
            tile_starts[tile + 1],
            tile,
            tile // (rows * columns),
            (tile % columns) * TILE_SIZE,
            ((tile // columns) % rows) * TILE_SIZE,
            width,
            height,
            backgrounds,
            masks,
            render_colors,
            render_alphas,
            render_depths,
            render_medians,
            taken,
        )

    return blend_tile
