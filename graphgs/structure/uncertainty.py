"""How far coarse poses may be off."""

from typing import NamedTuple

import numpy as np

from graphgs.scene.neighbours import median_spacing

_PER_AXIS = 1.5382  # median length of a vector of three standard normal numbers


class PoseUncertainty(NamedTuple):
    """Standard deviations of a camera pose, per axis and camera."""

    rotation: float  # [rad]
    position: float  # world units


# Nothing is known about the poses: 10 degrees between two cameras. With up to 0.3 rad and 0.3 camera spacings of noise
# at least 99.9 % of the pairs that share a tenth of a frustum are kept (docs/decisions/0011-filters.md).
UNKNOWN = PoseUncertainty(np.deg2rad(10.0) / np.sqrt(2.0), 0.0)
# A phone's GPS [m], with rotations of our own reconstruction, which may have drifted away from it.
GPS = PoseUncertainty(np.deg2rad(5.0), 3.0)


def of_reconstruction(centers: np.ndarray) -> PoseUncertainty:
    """Of a coarse reconstruction from the photos: about a degree and a percent of the camera spacing."""
    return PoseUncertainty(np.deg2rad(1.0), 0.01 * median_spacing(centers))


def measured(
    rotations: np.ndarray,  # [N, 3, 3] camera-from-world, to be judged
    centers: np.ndarray,  # [N, 3]
    trusted_rotations: np.ndarray,  # [N, 3, 3] of the same cameras in the same world
    trusted_centers: np.ndarray,  # [N, 3]
) -> PoseUncertainty:
    """From poses that are better, by the median difference: a few wrong cameras do not count."""
    turn = rotations @ trusted_rotations.transpose(0, 2, 1)
    angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0))
    shift = np.linalg.norm(centers - trusted_centers, axis=1)
    return PoseUncertainty(float(np.median(angle)) / _PER_AXIS, float(np.median(shift)) / _PER_AXIS)
