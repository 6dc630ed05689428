"""SSIM and L1, the CPU's shape: one thread per image row, float32, separable, sixteen values at a time.

A row is taken in blocks. The 11 image rows around it are added up, weighted, in registers, and leave four (backward:
three) rows of windowed sums with a halo on both sides, which are then smoothed along the row; the rest is arithmetic
on values in the first-level cache. Channels stay interleaved: along a row, the taps of one channel are 3 values apart.
The loops are C++ with Clang's vector types, as in the rasterizer (docs/kernels.md says why).
"""

import numpy as np
import warp as wp

from graphgs.kernels.cpu_flags import VECTOR_OPTIONS
from graphgs.kernels.ssim.window import C1, C2, RADIUS, TAPS

wp.set_module_options(VECTOR_OPTIONS)

_COMMON = f"""
    typedef float lanes __attribute__((ext_vector_type(16), aligned(4)));
    typedef int bits __attribute__((ext_vector_type(16), aligned(4)));
    const float taps[11] = {{{", ".join(f"{float(tap)!r}f" for tap in np.array(TAPS))}}};
    const lanes zero = 0.0f, order = {{0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}};
    constexpr int chunks = 15, halo = 16;  // of a block: chunks of 16 values, and 15 values more on each side
    const int length = 3 * width, y = row % height;
    const long here = (long)row * length, total = a.shape[0];
    alignas(64) float span[4][16 * chunks + 2 * halo];

    // Sixteen values from `at` on; beyond the end of the array there are none.
    auto load = [&](const float* array, long at, long size) -> lanes {{
        if (at + 16 <= size) return *(const lanes*)(array + at);
        lanes values = zero;
        for (long k = at; k < size; ++k) values[k - at] = array[k];
        return values;
    }};
    auto save = [&](lanes values, float* array, long at, int count) {{
        if (count >= 16) *(lanes*)(array + at) = values;
        else for (int k = 0; k < count; ++k) array[at + k] = values[k];
    }};
    // The window along the row, for 16 values of a span
    auto smooth = [&](const float* from) -> lanes {{
        lanes sum = taps[{RADIUS}] * *(const lanes*)from;
        #pragma unroll
        for (int k = 1; k <= {RADIUS}; ++k)
            sum += taps[{RADIUS} - k] * (*(const lanes*)(from - 3 * k) + *(const lanes*)(from + 3 * k));
        return sum;
    }};
    // The image rows in the window: zero padding beyond the rim, as 3DGS trains
    const int first = y < {RADIUS} ? {RADIUS} - y : 0;
    const int past = y + {RADIUS} < height ? 11 : {RADIUS} + height - y;
"""


@wp.func_native(
    _COMMON
    + f"""
    lanes error = zero, similarity = zero;
    for (int left = 0; left < length; left += 16 * chunks) {{
        for (int c = 0; c < chunks + 2; ++c) {{
            const int position = left - halo + 16 * c;
            lanes mean_a = zero, mean_b = zero, squares = zero, products = zero;
            if (position >= 0 && position < length) {{
                for (int t = first; t < past; ++t) {{
                    const long at = here + (long)(t - {RADIUS}) * length + position;
                    const lanes value_a = load(a.data, at, total), value_b = load(b.data, at, total);
                    mean_a += taps[t] * value_a;
                    mean_b += taps[t] * value_b;
                    squares += taps[t] * (value_a * value_a + value_b * value_b);
                    products += taps[t] * (value_a * value_b);
                }}
                if (position + 16 > length) {{  // what was read there belongs to the next row
                    const bits inside = order < (float)(length - position);
                    mean_a = inside ? mean_a : zero;
                    mean_b = inside ? mean_b : zero;
                    squares = inside ? squares : zero;
                    products = inside ? products : zero;
                }}
            }}
            *(lanes*)(span[0] + 16 * c) = mean_a;
            *(lanes*)(span[1] + 16 * c) = mean_b;
            *(lanes*)(span[2] + 16 * c) = squares;
            *(lanes*)(span[3] + 16 * c) = products;
        }}
        for (int c = 0; c < chunks && left + 16 * c < length; ++c) {{
            const int count = length - left - 16 * c;
            const long at = here + left + 16 * c;
            const lanes mean_a = smooth(span[0] + halo + 16 * c), mean_b = smooth(span[1] + halo + 16 * c);
            const lanes squares = smooth(span[2] + halo + 16 * c), products = smooth(span[3] + halo + 16 * c);

            // `ssim_terms` of window.py, with one division
            const lanes energy = mean_a * mean_a + mean_b * mean_b + {float(C1)!r}f, cross = mean_a * mean_b;
            const lanes variance = squares - energy + {float(C1) + float(C2)!r}f;
            const lanes luminance = 2.0f * cross + {float(C1)!r}f;
            const lanes structure = 2.0f * (products - cross) + {float(C2)!r}f;
            const lanes inverse = 1.0f / (energy * variance);
            const lanes value = luminance * structure * inverse;
            const lanes inverse_variance = inverse * energy;
            const lanes own = 2.0f * value * (inverse_variance - inverse * variance);
            const lanes other = 2.0f * (structure - luminance) * inverse;

            const lanes keep = load(kept.data, at, total);
            save(keep * (mean_a * own + mean_b * other), slopes.data, at, count);
            save(-keep * value * inverse_variance, slopes.data, total + at, count);
            save(2.0f * keep * luminance * inverse, slopes.data, 2 * total + at, count);
            const lanes gap = __builtin_elementwise_abs(load(a.data, at, total) - load(b.data, at, total));
            const bits inside = order < (float)count;
            error += inside ? keep * gap : zero;
            similarity += inside ? keep * value : zero;
        }}
    }}
    double error_sum = 0.0, similarity_sum = 0.0;
    for (int k = 0; k < 16; ++k) {{
        error_sum += error[k];
        similarity_sum += similarity[k];
    }}
    row_sums.data[row] = error_sum;
    row_sums.data[row_sums.shape[0] / 2 + row] = similarity_sum;
    """
)
def compare_row(
    row: int,
    a: wp.array[float],
    b: wp.array[float],
    kept: wp.array[float],
    height: int,
    width: int,
    slopes: wp.array[float],
    row_sums: wp.array[wp.float64],
):
    """One image row of `compare_rows`."""


@wp.kernel
def compare_rows(
    first: int,
    # Images, [C H W 3] flat
    a: wp.array[float],
    b: wp.array[float],
    kept: wp.array[float],  # 1 or 0
    height: int,
    width: int,
    # Out
    slopes: wp.array[float],  # [3 C H W 3] derivatives of kept SSIM in the windowed means of a, a^2 + b^2, a b
    row_sums: wp.array[wp.float64],  # [2 C H] kept |a - b| by row, then kept SSIM by row
):
    compare_row(first + wp.tid(), a, b, kept, height, width, slopes, row_sums)


@wp.func_native(
    _COMMON
    + f"""
    const float v_error = v_sums.data[0], v_similarity = v_sums.data[1];
    for (int left = 0; left < length; left += 16 * chunks) {{
        // The window is symmetric, so its adjoint is the same blur, applied to the slopes.
        for (int c = 0; c < chunks + 2; ++c) {{
            const int position = left - halo + 16 * c;
            lanes sums[3] = {{zero, zero, zero}};
            if (position >= 0 && position < length) {{
                for (int t = first; t < past; ++t) {{
                    const long at = here + (long)(t - {RADIUS}) * length + position;
                    #pragma unroll
                    for (int plane = 0; plane < 3; ++plane)
                        sums[plane] += taps[t] * load(slopes.data, plane * total + at, 3 * total);
                }}
                if (position + 16 > length) {{
                    const bits inside = order < (float)(length - position);
                    for (int plane = 0; plane < 3; ++plane) sums[plane] = inside ? sums[plane] : zero;
                }}
            }}
            for (int plane = 0; plane < 3; ++plane) *(lanes*)(span[plane] + 16 * c) = sums[plane];
        }}
        for (int c = 0; c < chunks && left + 16 * c < length; ++c) {{
            const long at = here + left + 16 * c;
            const lanes value_a = load(a.data, at, total), value_b = load(b.data, at, total);
            const lanes slope = smooth(span[0] + halo + 16 * c) + 2.0f * value_a * smooth(span[1] + halo + 16 * c)
                + value_b * smooth(span[2] + halo + 16 * c);
            const lanes sign = value_a > value_b ? (lanes)1.0f : (value_a < value_b ? (lanes)-1.0f : zero);
            const lanes gradient = load(kept.data, at, total) * (v_error * sign + v_similarity * slope);
            save(gradient, v_a.data, at, length - left - 16 * c);
        }}
    }}
    """
)
def compare_row_gradient(
    row: int,
    a: wp.array[float],
    b: wp.array[float],
    kept: wp.array[float],
    height: int,
    width: int,
    slopes: wp.array[float],
    v_sums: wp.array[float],
    v_a: wp.array[float],
):
    """One image row of `compare_rows_gradient`."""


@wp.kernel
def compare_rows_gradient(
    first: int,
    # Images, [C H W 3] flat; the gradient is that of `a`
    a: wp.array[float],
    b: wp.array[float],
    kept: wp.array[float],  # 1 or 0
    height: int,
    width: int,
    slopes: wp.array[float],  # [3 C H W 3] from `compare_rows`
    v_sums: wp.array[float],  # [2] gradient of the sum of errors, of the sum of similarities
    # Out
    v_a: wp.array[float],  # [C H W 3]
):
    compare_row_gradient(first + wp.tid(), a, b, kept, height, width, slopes, v_sums, v_a)
