"""Real spherical harmonics up to degree 3, in the field's order and signs (Sloan, "Efficient Spherical Harmonic
Evaluation", JCGT 2013; the same polynomials as gsplat and the splat.ply format)."""

from typing import Any

import warp as wp


@wp.func
def sh_sum(
    degree: int,
    direction: Any,  # unit length
    weights: Any,  # 16 numbers; those past the degree are not read
):
    """sum_k weights[k] * basis_k(direction). Linear in `weights`, so its gradient by them is the basis itself."""
    x, y, z = direction[0], direction[1], direction[2]
    real = direction.dtype(1.0)
    total = direction.dtype(0.2820947917738781) * weights[0]
    if degree >= 1:
        total += direction.dtype(0.48860251190292) * (z * weights[2] - y * weights[1] - x * weights[3])
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        c1 = direction.dtype(1.092548430592079)
        total += c1 * (x * y * weights[4] - y * z * weights[5] - x * z * weights[7])
        total += direction.dtype(0.5462742152960395) * (xx - yy) * weights[8]
        total += (direction.dtype(0.9461746957575601) * zz - direction.dtype(0.3153915652525201)) * weights[6]
    if degree >= 3:
        xx, yy, zz = x * x, y * y, z * z
        three, five = direction.dtype(3.0), direction.dtype(5.0)
        c0 = direction.dtype(0.5900435899266435)
        c1 = direction.dtype(0.4570457994644658)
        total += c0 * (y * (yy - three * xx) * weights[9] - x * (xx - three * yy) * weights[15])
        total += c1 * (real - five * zz) * (y * weights[11] + x * weights[13])
        total += direction.dtype(2.890611442640554) * x * y * z * weights[10]
        total += direction.dtype(0.3731763325901154) * z * (five * zz - three) * weights[12]
        total += direction.dtype(1.445305721320277) * z * (xx - yy) * weights[14]
    return total


@wp.func
def sh_basis(
    degree: int,
    direction: Any,  # unit length
    zeros: Any,  # 16 zeros: names the vector type
):
    """The 16 basis functions at a direction; 0 past the degree."""
    _degree, _direction, basis = wp.grad(sh_sum)(degree, direction, zeros)
    return basis
