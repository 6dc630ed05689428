"""The size of a scene, as learning rates and thresholds need it."""

import numpy as np

_TO_RADIUS = 1.1  # 3DGS takes 1.1 times the largest distance of a camera from the mean of all


def scene_extent(
    centers: np.ndarray,  # [N, 3] camera centres, world
    points: np.ndarray | None = None,  # [P, 3] world
) -> float:
    """A length in world units that one wrong camera or point cannot change much.

    3DGS uses the largest distance of a camera from the mean, which a single outlier sets. Here both are medians: the
    median distance from the (coordinate-wise) median centre, scaled so that cameras spread evenly over a disc give
    3DGS's value. Cameras that all stand in one place fall back to the median distance of the points."""
    extent = _radius(centers)
    if extent > 0.0:
        return extent
    if points is not None and len(points):
        distance = np.median(np.linalg.norm(points - np.median(centers, axis=0), axis=1))
        if distance > 0.0:
            return float(distance)
    return 1.0


def _radius(centers: np.ndarray) -> float:
    # half of a disc's area lies within 1 / sqrt(2) of its radius
    distances = np.linalg.norm(centers - np.median(centers, axis=0), axis=1)
    return float(_TO_RADIUS * np.sqrt(2.0) * np.median(distances))
