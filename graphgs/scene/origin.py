"""A near zero for scenes that lie far from it.

Training, rendering and splat.ply hold positions in float32, which has 24 bits: at 5,412,345 m, a northing of UTM, it
knows steps of half a metre. So a scene whose cameras stand far out is moved near zero once, while all is in float64,
and remembers by how much: `origin` is where its zero lies in the frame it came in.
"""

import dataclasses

import numpy as np

from graphgs.scene.reconstruction import Reconstruction

Origin = tuple[float, float, float]  # in the frame the scene came in, in its units
AT_ZERO: Origin = (0.0, 0.0, 0.0)

# Training's last steps are 1.6e-6 of the extent. float32 is spaced 2^-23 of a coordinate's size, so that at 8 extents
# a step is still as long as one spacing, and further out it is lost in rounding.
FAR = 8.0  # extents


def near_zero(reconstruction: Reconstruction) -> tuple[Reconstruction, Origin]:
    """The scene moved so that its cameras stand around zero, and the origin that this took; as it is, with the origin
    0, where it is near enough."""
    origin = origin_for(reconstruction.centers)
    return (reconstruction, AT_ZERO) if origin == AT_ZERO else (moved(reconstruction, origin), origin)


def origin_for(
    centers: np.ndarray,  # [N, 3] camera centres
) -> Origin:
    """The cameras' middle where it is more than `FAR` extents from zero, else zero.

    It is rounded to a power of two of about the extent: few bits, so that subtracting it from coordinates further out
    is exact, and so is adding it again."""
    if not len(centers):
        return AT_ZERO
    middle = np.median(centers, axis=0)
    extent = float(np.median(np.linalg.norm(centers - middle, axis=1)))
    if not 0.0 < FAR * extent < np.linalg.norm(middle):
        return AT_ZERO
    step = 2.0 ** np.floor(np.log2(extent))
    return tuple(float(v) for v in np.round(middle / step) * step)


def moved(reconstruction: Reconstruction, origin: Origin) -> Reconstruction:
    """The same scene in a frame whose zero lies at `origin`. x_cam = R (x - o) + (R o + t)."""
    return dataclasses.replace(
        reconstruction,
        translations=reconstruction.translations + reconstruction.rotations @ np.array(origin),
        points=reconstruction.points - np.array(origin),
    )


def moved_back(reconstruction: Reconstruction, origin: Origin) -> Reconstruction:
    """The scene in the frame it came in."""
    return moved(reconstruction, tuple(-v for v in origin))


def describe(origin: Origin) -> str:
    """One line for people."""
    place = ", ".join(f"{v:.15g}" for v in origin)
    return (
        "the poses lie far from zero, where single precision is too coarse: the scene is kept about "
        f"({place}) of their frame; colmap/original/ is written in that frame"
    )
