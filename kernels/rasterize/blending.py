"""What one pixel does with one splat: shared by the shapes that are written in plain Warp, forward and backward."""

from typing import Any

import warp as wp


@wp.func
def falloff_at(offset: Any, conic: Any):
    """exp(-sigma) at an offset from the mean [px]; sigma is half the squared Mahalanobis distance."""
    dx, dy = offset[0], offset[1]
    return wp.exp(-(offset.dtype(0.5) * (conic[0] * dx * dx + conic[2] * dy * dy) + conic[1] * dx * dy))


@wp.func
def sees_splats(masks: wp.array[wp.uint8], index: int):
    """Whether the mask lets a pixel see anything but the background. No mask is an empty array."""
    seen = bool(True)
    if masks.shape[0] > 0:
        seen = masks[index] != wp.uint8(0)
    return seen


@wp.func
def halves_light(transmittance: Any, behind: Any):
    """Whether this splat is the median: it takes the light from above one half to one half or less."""
    half = behind.dtype(0.5)
    return transmittance > half and behind <= half
