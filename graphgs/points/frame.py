"""The cube an octree divides: linear where most points are, contracted beyond, so that no outlier is too far.

A reconstruction has points far behind everything else. A root cell around them would leave one leaf for the scene;
clamping them to the rim would throw them together. So space outside the core is contracted as mip-NeRF 360 (Barron et
al. 2022, Eq. 10) does, in the maximum norm: cells grow with the square of the distance and every point has one.
"""

from dataclasses import dataclass

import numpy as np

BITS = 28  # of a quantised coordinate; 512 leaf cells per axis take the upper 9
SIDE = 4.0  # the contracted cube is [-2, 2], its core [-1, 1]
CORE_QUANTILES = (0.02, 0.98)  # of each coordinate: what lies between is the core
FARTHEST = 1e12  # in core half sides; beyond, a point keeps its direction only


@dataclass(frozen=True)
class Frame:
    """Where the octree lies in the world."""

    center: np.ndarray  # [3] world
    half: float  # world, half the side of the core

    @staticmethod
    def around(
        positions: np.ndarray,  # [N, 3] world
    ) -> "Frame":
        """Core about the median, wide enough for the middle 96 % of each coordinate, with a tenth to spare."""
        center = np.median(positions, axis=0)
        spread = np.abs(np.quantile(positions, CORE_QUANTILES, axis=0) - center).max()
        if spread == 0:  # nearly all points coincide
            spread = np.abs(positions - center).max()
        return Frame(center, 1.1 * float(spread) if spread > 0 else 1.0)

    def quantize(
        self,
        positions: np.ndarray,  # [N, 3] world
    ) -> np.ndarray:
        """[N, 3] int64 in 0 .. 2^BITS - 1."""
        local = np.clip((positions - self.center) / self.half, -FARTHEST, FARTHEST)
        radius = np.maximum(np.abs(local).max(1, keepdims=True), 1.0)
        contracted = local * ((2.0 - 1.0 / radius) / radius)
        return np.clip(np.floor((contracted / SIDE + 0.5) * 2.0**BITS), 0, 2**BITS - 1).astype(np.int64)

    def positions(
        self,
        coordinates: np.ndarray,  # [N, 3] float, quantised units
    ) -> np.ndarray:
        """[N, 3] world; the inverse of `quantize` for the middle of a step."""
        contracted = ((coordinates + 0.5) / 2.0**BITS - 0.5) * SIDE
        radius = np.abs(contracted).max(1, keepdims=True)
        stretch = np.where(radius > 1.0, 1.0 / np.maximum(radius * (2.0 - radius), 1e-12), 1.0)
        return self.center + self.half * stretch * contracted

    def cell_size(
        self,
        positions: np.ndarray,  # [N, 3] world
        level: np.ndarray | int,  # [N] or one for all
    ) -> np.ndarray:
        """[N] side of a cell of that level where a point lies, world (across the line of sight from the core)."""
        radius = np.maximum(np.abs((positions - self.center) / self.half).max(1), 1.0)
        return SIDE * self.half * 2.0 ** -np.asarray(level, float) * radius * (radius / (2.0 * radius - 1.0))


def morton(
    cells: np.ndarray,  # [N, 3] int, up to 21 bits each
) -> np.ndarray:
    """[N] int64 code whose upper bits are the codes of the coarser cells: x, y, z bits take turns."""
    code = np.zeros(len(cells), np.int64)
    for axis in range(3):
        x = cells[:, axis].astype(np.int64)
        for shift, mask in (
            (32, 0x1F00000000FFFF),
            (16, 0x1F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):
            x = (x | (x << shift)) & mask
        code |= x << (2 - axis)
    return code
