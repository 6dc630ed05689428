"""SSIM and L1, the CPU's shape: one thread per image row, float32, separable, every inner loop vectorised.

A row is taken in blocks. The 11 image rows around it are added up, weighted, into a block that carries a halo on both
sides (the vertical pass), the block is smoothed along the row (the horizontal pass), and what is left is arithmetic on
values in the first-level cache. Channels stay interleaved: along a row, the taps of one channel are 3 values apart.

What the vectoriser needs, as its own remarks (-Rpass-analysis=loop-vectorize) say:
- `while` where the trip count is not a constant: the loop that `for k in range(n)` becomes is not recognised;
- offsets passed through `wp.max(..., 0)` before the loop: Warp wraps negative indices, and only a provably
  non-negative index stays a plain address;
- buffers on the stack (`wp.zeros` in a kernel), which cannot overlap the arguments.
"""

import numpy as np
import warp as wp

from graphgs.kernels.cpu_flags import vector_flags
from graphgs.kernels.ssim.window import RADIUS, TAPS, l1_slope, ssim_terms

wp.set_module_options({"enable_backward": False, "max_unroll": 0, "cpu_compiler_flags": vector_flags()})

BLOCK = wp.constant(240)  # values of a row handled at a time: 80 px, 15 vectors
HALO = wp.constant(16)  # 15 values are needed; with 16 the inner loops have no remainder to do one by one
SPAN = wp.constant(BLOCK + 2 * HALO)
LANES = wp.constant(16)

_PLANES = 4  # windowed means
SPANS = wp.constant(_PLANES * SPAN)
BLOCKS = wp.constant(_PLANES * BLOCK)
SUM_LANES = wp.constant(2 * LANES)

# The window's weights from the rim to the centre
W0, W1, W2, W3, W4, W5 = (wp.constant(float(w)) for w in np.array(TAPS)[: RADIUS + 1])


@wp.func
def tap_weight(y: int, t: int, height: int):
    """The window's weight for image row y + t - RADIUS; 0 beyond the image's rim (zero padding, as 3DGS trains)."""
    inside = t < 11 and y + t >= RADIUS and y + t < height + RADIUS
    return wp.where(inside, float(TAPS[wp.min(t, 10)]), 0.0)


@wp.func
def tap_start(row: int, y: int, t: int, height: int, length: int, lo: int):
    """Index of value `lo` in that row, or in the nearest row that exists (its weight is 0)."""
    return wp.max((row - y + wp.clamp(y + t - RADIUS, 0, height - 1)) * length + lo, 0)


@wp.func
def smooth_along_row(
    span: wp.array[float],  # [4 SPAN]
    # Out
    block: wp.array[float],  # [4 BLOCK]
):
    for plane in range(4):
        source = wp.max(plane * SPAN, 0)
        target = wp.max(plane * BLOCK, 0)
        for k in range(BLOCK):
            at = source + k
            block[target + k] = (
                W0 * (span[at + 1] + span[at + 31])
                + W1 * (span[at + 4] + span[at + 28])
                + W2 * (span[at + 7] + span[at + 25])
                + W3 * (span[at + 10] + span[at + 22])
                + W4 * (span[at + 13] + span[at + 19])
                + W5 * span[at + 16]
            )


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
    row = first + wp.tid()
    y = row % height
    rows = row_sums.shape[0] / 2
    count = a.shape[0]
    length = 3 * width
    lanes = wp.zeros(shape=SUM_LANES, dtype=float)
    left = int(0)
    while left < length:
        right = wp.min(left + BLOCK, length)
        lo = wp.max(left - HALO, 0)
        hi = wp.min(right + HALO, length)

        # Vertical pass, four image rows at a time
        span = wp.zeros(shape=SPANS, dtype=float)
        begin = wp.max(lo - left + HALO, 0)
        for group in range(3):
            t = 4 * group
            at_0 = tap_start(row, y, t, height, length, lo)
            at_1 = tap_start(row, y, t + 1, height, length, lo)
            at_2 = tap_start(row, y, t + 2, height, length, lo)
            at_3 = tap_start(row, y, t + 3, height, length, lo)
            w_0 = tap_weight(y, t, height)
            w_1 = tap_weight(y, t + 1, height)
            w_2 = tap_weight(y, t + 2, height)
            w_3 = tap_weight(y, t + 3, height)
            k = int(0)
            while k < hi - lo:
                a_0, a_1, a_2, a_3 = a[at_0 + k], a[at_1 + k], a[at_2 + k], a[at_3 + k]
                b_0, b_1, b_2, b_3 = b[at_0 + k], b[at_1 + k], b[at_2 + k], b[at_3 + k]
                at = begin + k
                span[at] = span[at] + (w_0 * a_0 + w_1 * a_1 + w_2 * a_2 + w_3 * a_3)
                span[at + SPAN] = span[at + SPAN] + (w_0 * b_0 + w_1 * b_1 + w_2 * b_2 + w_3 * b_3)
                span[at + 2 * SPAN] = span[at + 2 * SPAN] + (
                    w_0 * (a_0 * a_0 + b_0 * b_0)
                    + w_1 * (a_1 * a_1 + b_1 * b_1)
                    + w_2 * (a_2 * a_2 + b_2 * b_2)
                    + w_3 * (a_3 * a_3 + b_3 * b_3)
                )
                span[at + 3 * SPAN] = span[at + 3 * SPAN] + (
                    w_0 * (a_0 * b_0) + w_1 * (a_1 * b_1) + w_2 * (a_2 * b_2) + w_3 * (a_3 * b_3)
                )
                k = k + 1
        means = wp.zeros(shape=BLOCKS, dtype=float)
        smooth_along_row(span, means)

        # The planes of slopes, then the two sums
        here = wp.max(row * length + left, 0)
        plane_1 = wp.max(here + count, 0)
        plane_2 = wp.max(here + 2 * count, 0)
        similarity = wp.zeros(shape=BLOCK, dtype=float)
        error = wp.zeros(shape=BLOCK, dtype=float)
        k = int(0)
        while k < right - left:
            value, d_mean, d_squares, d_products = ssim_terms(
                means[k], means[k + BLOCK], means[k + 2 * BLOCK], means[k + 3 * BLOCK]
            )
            keep = kept[here + k]
            slopes[here + k] = keep * d_mean
            slopes[plane_1 + k] = keep * d_squares
            slopes[plane_2 + k] = keep * d_products
            similarity[k] = keep * value
            error[k] = keep * wp.abs(a[here + k] - b[here + k])
            k = k + 1
        for chunk in range(BLOCK / LANES):
            source = wp.max(chunk * LANES, 0)
            for lane in range(LANES):
                lanes[lane] = lanes[lane] + error[source + lane]
                lanes[LANES + lane] = lanes[LANES + lane] + similarity[source + lane]
        left = left + BLOCK

    error_sum = wp.float64(0.0)
    similarity_sum = wp.float64(0.0)
    for lane in range(LANES):
        error_sum += wp.float64(lanes[lane])
        similarity_sum += wp.float64(lanes[LANES + lane])
    row_sums[row] = error_sum
    row_sums[rows + row] = similarity_sum


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
    row = first + wp.tid()
    y = row % height
    count = a.shape[0]
    length = 3 * width
    v_error = v_sums[0]
    v_similarity = v_sums[1]
    left = int(0)
    while left < length:
        right = wp.min(left + BLOCK, length)
        lo = wp.max(left - HALO, 0)
        hi = wp.min(right + HALO, length)

        # The window is symmetric, so its adjoint is the same blur, applied to the slopes
        span = wp.zeros(shape=SPANS, dtype=float)
        begin = wp.max(lo - left + HALO, 0)
        for plane in range(3):
            offset = plane * count
            target = wp.max(plane * SPAN + begin, 0)
            for group in range(3):
                t = 4 * group
                at_0 = wp.max(tap_start(row, y, t, height, length, lo) + offset, 0)
                at_1 = wp.max(tap_start(row, y, t + 1, height, length, lo) + offset, 0)
                at_2 = wp.max(tap_start(row, y, t + 2, height, length, lo) + offset, 0)
                at_3 = wp.max(tap_start(row, y, t + 3, height, length, lo) + offset, 0)
                w_0 = tap_weight(y, t, height)
                w_1 = tap_weight(y, t + 1, height)
                w_2 = tap_weight(y, t + 2, height)
                w_3 = tap_weight(y, t + 3, height)
                k = int(0)
                while k < hi - lo:
                    near = w_0 * slopes[at_0 + k] + w_1 * slopes[at_1 + k]
                    far = w_2 * slopes[at_2 + k] + w_3 * slopes[at_3 + k]
                    span[target + k] = span[target + k] + (near + far)
                    k = k + 1
        smoothed = wp.zeros(shape=BLOCKS, dtype=float)
        smooth_along_row(span, smoothed)

        here = wp.max(row * length + left, 0)
        k = int(0)
        while k < right - left:
            value_a = a[here + k]
            value_b = b[here + k]
            slope = smoothed[k] + 2.0 * value_a * smoothed[k + BLOCK] + value_b * smoothed[k + 2 * BLOCK]
            v_a[here + k] = kept[here + k] * (v_error * l1_slope(value_a, value_b) + v_similarity * slope)
            k = k + 1
        left = left + BLOCK
