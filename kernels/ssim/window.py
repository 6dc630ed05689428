"""The maths of SSIM (Wang et al. 2004): the Gaussian window, and one pixel's index with its partial derivatives."""

from typing import Any

import numpy as np
import warp as wp

RADIUS = 5  # [px]; the window is 11 px wide
SIGMA = 1.5  # [px]

_offsets = np.arange(-RADIUS, RADIUS + 1)
_weights = np.exp(-0.5 * (_offsets / SIGMA) ** 2)
_weights /= _weights.sum()

TAPS = wp.constant(wp.types.vector(11, wp.float64)(*_weights))  # the window along one axis, sum 1
C1 = wp.constant(0.01**2)  # both for a data range of 1
C2 = wp.constant(0.03**2)


@wp.func
def ssim_terms(
    # Windowed means of one pixel
    mean_a: Any,
    mean_b: Any,
    squares: Any,  # of a^2 + b^2: SSIM needs the two variances only as a sum
    products: Any,  # of a b
):
    """SSIM of the pixel, then its derivatives in `mean_a`, `squares` and `products`."""
    two = type(mean_a)(2.0)
    c1 = type(mean_a)(C1)
    c2 = type(mean_a)(C2)
    energy = mean_a * mean_a + mean_b * mean_b
    cross = mean_a * mean_b
    luminance = two * cross + c1
    structure = two * (products - cross) + c2
    inv_energy = type(mean_a)(1.0) / (energy + c1)
    inv_variance = type(mean_a)(1.0) / (squares - energy + c2)
    inverse = inv_energy * inv_variance
    value = luminance * structure * inverse
    own = two * value * (inv_variance - inv_energy)
    other = two * (structure - luminance) * inverse
    return value, mean_a * own + mean_b * other, -value * inv_variance, two * luminance * inverse


@wp.func
def l1_slope(a: Any, b: Any):
    """Derivative of |a - b| in a; 0 where they are equal."""
    one = type(a)(1.0)
    return wp.where(a > b, one, wp.where(a < b, -one, type(a)(0.0)))
