"""Opacity of one Gaussian at one pixel: the formula both shapes of the rasterizer share."""

from typing import Any

import warp as wp


@wp.func
def sigma_at(
    dx: Any,  # pixel centre minus mean [px]
    dy: Any,
    a: Any,  # conic
    b: Any,
    c: Any,
):
    """Half the squared Mahalanobis distance."""
    return dx.dtype(0.5) * (a * dx * dx + c * dy * dy) + b * dx * dy
