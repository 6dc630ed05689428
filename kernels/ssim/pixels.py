"""SSIM and L1, the plain shape: one thread per pixel and channel, a direct 11 x 11 window. Any float type, any device.

float32 runs `rows.py` on the CPU and `blocks.py` on CUDA instead; all call the maths of `window.py`.

The adjoint: SSIM at p is a function S_p of the means mu_a, mu_b, mu_(a^2 + b^2), mu_ab in the window w around p, so the
sum of kept_p S_p has, at pixel q, the derivative in a

    sum_p w(p - q) kept_p (dS_p/dmu_a + 2 a_q dS_p/dmu_(a^2 + b^2) + b_q dS_p/dmu_ab)

The forward pass writes the three derivatives ("slopes", times kept); as w is symmetric, the backward pass blurs them.
"""

from typing import Any

import warp as wp

from graphgs.kernels.ssim.window import RADIUS, TAPS, l1_slope, ssim_terms

wp.set_module_options({"enable_backward": False, "max_unroll": 0})

SIDE = wp.constant(2 * RADIUS + 1)
REACH = wp.constant(RADIUS)


@wp.func
def split_index(index: int, height: int, width: int):
    """(row over all images, y, x, channel) of a value of [C, H, W, 3]."""
    channel = index % 3
    pixel = index / 3
    row = pixel / width
    return row, row % height, pixel % width, channel


@wp.kernel
def compare_pixels(
    first: int,
    # Images, [C H W 3] flat
    a: wp.array[Any],
    b: wp.array[Any],
    kept: wp.array[Any],  # 1 or 0
    height: int,
    width: int,
    # Out
    slopes: wp.array[Any],  # [3 C H W 3] derivatives of kept SSIM in the windowed means of a, a^2 + b^2, a b
    errors: wp.array[Any],  # [C H W 3] kept |a - b|
    similarities: wp.array[Any],  # [C H W 3] kept SSIM
):
    index = first + wp.tid()
    row, y, x, channel = split_index(index, height, width)
    mean_a = a.dtype(0.0)
    mean_b = a.dtype(0.0)
    squares = a.dtype(0.0)
    products = a.dtype(0.0)
    for v in range(SIDE):
        for u in range(SIDE):
            qy = y + v - REACH
            qx = x + u - REACH
            if qy >= 0 and qy < height and qx >= 0 and qx < width:  # zero padding, as 3DGS trains
                at = ((row + v - REACH) * width + qx) * 3 + channel
                weight = a.dtype(TAPS[v] * TAPS[u])
                mean_a += weight * a[at]
                mean_b += weight * b[at]
                squares += weight * (a[at] * a[at] + b[at] * b[at])
                products += weight * (a[at] * b[at])
    value, d_mean, d_squares, d_products = ssim_terms(mean_a, mean_b, squares, products)
    count = a.shape[0]
    keep = kept[index]
    slopes[index] = keep * d_mean
    slopes[count + index] = keep * d_squares
    slopes[2 * count + index] = keep * d_products
    errors[index] = keep * wp.abs(a[index] - b[index])
    similarities[index] = keep * value


@wp.kernel
def compare_pixels_gradient(
    first: int,
    # Images, [C H W 3] flat; the gradient is that of `a`
    a: wp.array[Any],
    b: wp.array[Any],
    kept: wp.array[Any],  # 1 or 0
    height: int,
    width: int,
    slopes: wp.array[Any],  # [3 C H W 3] from `compare_pixels`
    v_sums: wp.array[Any],  # [2] gradient of the sum of errors, of the sum of similarities
    # Out
    v_a: wp.array[Any],  # [C H W 3]
):
    index = first + wp.tid()
    row, y, x, channel = split_index(index, height, width)
    count = a.shape[0]
    v_mean = a.dtype(0.0)
    v_squares = a.dtype(0.0)
    v_products = a.dtype(0.0)
    for v in range(SIDE):
        for u in range(SIDE):
            qy = y + v - REACH
            qx = x + u - REACH
            if qy >= 0 and qy < height and qx >= 0 and qx < width:
                at = ((row + v - REACH) * width + qx) * 3 + channel
                weight = a.dtype(TAPS[v] * TAPS[u])
                v_mean += weight * slopes[at]
                v_squares += weight * slopes[count + at]
                v_products += weight * slopes[2 * count + at]
    v_similarity = v_mean + a.dtype(2.0) * a[index] * v_squares + b[index] * v_products
    v_a[index] = kept[index] * (v_sums[0] * l1_slope(a[index], b[index]) + v_sums[1] * v_similarity)


for _real in (wp.float32, wp.float64):
    _values = wp.array(dtype=_real, ndim=1)
    wp.overload(compare_pixels, [int, *[_values] * 3, int, int, *[_values] * 3])
    wp.overload(compare_pixels_gradient, [int, *[_values] * 3, int, int, *[_values] * 3])
