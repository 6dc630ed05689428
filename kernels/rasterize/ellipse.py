"""Where a splat's alpha is at least ALPHA_MIN: the ellipse sigma(dx, dy) <= ln(opacity / ALPHA_MIN), cut into bands."""

import warp as wp

from graphgs.kernels.rasterize.constants import ALPHA_MIN


@wp.struct
class Ellipse:
    slope: float  # b / a of the conic
    height: float  # [px] half extent in y
    right_y: float  # [px] dy of the rightmost point
    flatness: float  # det / a^2
    width: float  # [px^2] squared half width of the chord dy = 0


@wp.func
def alpha_ellipse(conic: wp.vec3, opacity: float):
    a, b, c = conic[0], conic[1], conic[2]
    det = wp.max(a * c - b * b, 1e-20)
    level = 2.0 * wp.log(opacity / ALPHA_MIN) + 1e-4  # a little more, for the rounding of what follows
    ellipse = Ellipse()
    ellipse.slope = b / a
    ellipse.height = wp.sqrt(level * a / det)
    ellipse.right_y = -b * wp.sqrt(level / (det * c))
    ellipse.flatness = det / (a * a)
    ellipse.width = level / a
    return ellipse


@wp.func
def band_extent(
    ellipse: Ellipse,
    top: float,  # [px] from the mean
    bottom: float,
):
    """Leftmost and rightmost dx of the part of the ellipse with dy in [top, bottom]; left > right if there is none."""
    lo = wp.max(top, -ellipse.height)
    hi = wp.min(bottom, ellipse.height)
    left = float(1.0)
    right = float(-1.0)
    if lo <= hi:
        at_left = wp.clamp(-ellipse.right_y, lo, hi)
        at_right = wp.clamp(ellipse.right_y, lo, hi)
        left = -ellipse.slope * at_left - chord(ellipse, at_left)
        right = -ellipse.slope * at_right + chord(ellipse, at_right)
    return left, right


@wp.func
def chord(ellipse: Ellipse, dy: float):
    """Half the width of the ellipse at that height."""
    return wp.sqrt(wp.max(ellipse.width - ellipse.flatness * dy * dy, 0.0))


@wp.func
def cells_between(
    left: float,  # [px]
    right: float,
    cell: float,  # [px] width of a cell
    count: int,
):
    """First and last of `count` cells in a row that hold a pixel centre between the two; first > last if none does."""
    if left > right:
        return 1, 0
    first_column = wp.ceil(wp.clamp(left, -1.0, float(count) * cell + 1.0) - 0.5)
    last_column = wp.floor(wp.clamp(right, -1.0, float(count) * cell + 1.0) - 0.5)
    if first_column > last_column:
        return 1, 0
    first = wp.max(int(wp.floor(first_column / cell)), 0)
    last = wp.min(int(wp.floor(last_column / cell)), count - 1)
    return first, last
