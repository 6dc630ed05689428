"""What compositing reads and writes. Splat arrays are flat over cameras: splat = camera * N + Gaussian."""

from dataclasses import dataclass
from functools import cache

import warp as wp


@dataclass(frozen=True)
class Splats:
    """Projected Gaussians, or their gradients. Projection itself knows no colours."""

    means2d: wp.array  # [C * N] vec2 [px]
    conics: wp.array  # [C * N] vec3 [px^-2]
    depths: wp.array  # [C * N]
    opacities: wp.array  # [C * N]
    colors: wp.array | None = None  # [C * N] vector of D channels, 1 to 32
    abs_means2d: wp.array | None = None  # gradients only, [C * N] vec2: sum over pixels of |their share of means2d|


@dataclass(frozen=True)
class Frame:
    """The images to fill."""

    cameras: int
    width: int  # [px]
    height: int  # [px]
    backgrounds: wp.array  # [C] vector of D channels
    masks: wp.array | None = None  # [C * H * W] uint8; where 0, a pixel sees no splat: background, alpha 0, no gradient


@dataclass(frozen=True)
class Image:
    """Rendered pixels, or their cotangents; of these the GPU's shape reads None as 0."""

    colors: wp.array  # [C * H * W] vector of D channels
    alphas: wp.array | None  # [C * H * W]
    depths: wp.array | None  # [C * H * W] expected depth
    median_depths: wp.array | None = None  # [C * H * W] depth of the splat that halves the light; 0 = light stays above


def or_empty(array: wp.array | None, dtype, device) -> wp.array:
    """As a kernel takes it: an array that is not wanted has no elements."""
    return _empty(dtype, device.alias) if array is None else array


@cache
def _empty(dtype: type, device: str) -> wp.array:
    return wp.empty(0, dtype=dtype, device=device)
