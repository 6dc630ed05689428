"""Real spherical harmonics up to degree 3, in the field's order and signs (Sloan, "Efficient Spherical Harmonic
Evaluation", JCGT 2013; the same polynomials as gsplat and the splat.ply format).

A band is a function of the direction (unit length) and of one weight per basis function, and gives the weighted sum. It
is linear in the weights, so its gradient by them, which Warp derives, is the basis itself. Bands are apart so that no
loop runs to a length known only at run time: vectors indexed in such a loop lie in memory on a GPU, not in registers.
"""

from typing import Any

import warp as wp

BAND_0 = wp.constant(0.2820947917738781)  # the first basis function


@wp.func
def band_1(
    direction: Any,
    weights: Any,  # 3 numbers
):
    x, y, z = direction[0], direction[1], direction[2]
    return direction.dtype(0.48860251190292) * (z * weights[1] - y * weights[0] - x * weights[2])


@wp.func
def band_2(
    direction: Any,
    weights: Any,  # 5 numbers
):
    x, y, z = direction[0], direction[1], direction[2]
    xx, yy, zz = x * x, y * y, z * z
    total = direction.dtype(1.092548430592079) * (x * y * weights[0] - y * z * weights[1] - x * z * weights[3])
    total += direction.dtype(0.5462742152960395) * (xx - yy) * weights[4]
    total += (direction.dtype(0.9461746957575601) * zz - direction.dtype(0.3153915652525201)) * weights[2]
    return total


@wp.func
def band_3(
    direction: Any,
    weights: Any,  # 7 numbers
):
    x, y, z = direction[0], direction[1], direction[2]
    xx, yy, zz = x * x, y * y, z * z
    one, three, five = direction.dtype(1.0), direction.dtype(3.0), direction.dtype(5.0)
    c0 = direction.dtype(0.5900435899266435)
    c1 = direction.dtype(0.4570457994644658)
    total = c0 * (y * (yy - three * xx) * weights[0] - x * (xx - three * yy) * weights[6])
    total += c1 * (one - five * zz) * (y * weights[2] + x * weights[4])
    total += direction.dtype(2.890611442640554) * x * y * z * weights[1]
    total += direction.dtype(0.3731763325901154) * z * (five * zz - three) * weights[3]
    total += direction.dtype(1.445305721320277) * z * (xx - yy) * weights[5]
    return total


@wp.func
def band_color(
    coefficients: wp.array2d[Any],  # [N, K] vec3
    g: int,
    first: int,  # of the band, among K
    basis: Any,
):
    """sum_k basis[k] * coefficients[g, first + k]."""
    color = basis[0] * coefficients[g, first]
    for k in range(1, len(basis)):
        color += basis[k] * coefficients[g, first + k]
    return color


@wp.func
def band_weights(
    coefficients: wp.array2d[Any],  # [N, K] vec3
    g: int,
    first: int,
    v_color: Any,
    zeros: Any,  # names the vector type
):
    """A band's weights in the sum over channels of v_color * colour."""
    weights = zeros
    for k in range(len(zeros)):
        weights[k] = wp.dot(coefficients[g, first + k], v_color)
    return weights


@wp.func
def add_band(
    v_coefficients: wp.array2d[Any],  # [N, K] vec3
    g: int,
    first: int,
    basis: Any,
    v_color: Any,
):
    for k in range(len(basis)):
        v_coefficients[g, first + k] += basis[k] * v_color
