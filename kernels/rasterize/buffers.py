"""What compositing reads and writes. Splat arrays are flat over cameras: splat = camera * N + Gaussian."""

from dataclasses import dataclass

import warp as wp


@dataclass(frozen=True)
class Splats:
    """Projected Gaussians, or their gradients. Projection itself knows no colours."""

    means2d: wp.array  # [C * N] vec2 [px]
    conics: wp.array  # [C * N] vec3 [px^-2]
    depths: wp.array  # [C * N]
    opacities: wp.array  # [C * N]
    colors: wp.array | None = None  # [C * N] vec3


@dataclass(frozen=True)
class Frame:
    """The images to fill."""

    cameras: int
    width: int  # [px]
    height: int  # [px]
    backgrounds: wp.array  # [C] vec3


@dataclass(frozen=True)
class Image:
    """Rendered pixels, or their cotangents."""

    colors: wp.array  # [C * H * W] vec3
    alphas: wp.array  # [C * H * W]
    depths: wp.array  # [C * H * W] expected depth
