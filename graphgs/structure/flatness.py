"""Does everything lie in one plane, seen from one direction? Then focal length and distance cannot be told apart: the
scene may be any depth, and nothing in the photos objects.
"""

import numpy as np

from graphgs.scene.reconstruction import Reconstruction

_FLAT = 0.01  # thickness of a plane of points, as a share of its extent
_KEPT = 0.9  # of the points; the rest may be outliers
_ROUNDS = 5
_ONE_DIRECTION_DEG = 10.0  # cameras whose axes spread less see the plane from one side only


def thickness(
    points: np.ndarray,  # [P, 3]
) -> float:
    """How far the points lie off the plane that fits nine tenths of them best, as a share of their spread in it."""
    if len(points) < 4:
        return 0.0
    kept = points
    for _ in range(_ROUNDS):
        middle = kept.mean(0)
        normal = np.linalg.svd(kept - middle, full_matrices=False)[2][2]
        away = np.abs((points - middle) @ normal)
        kept = points[away <= np.quantile(away, _KEPT)]
    spread = np.median(np.linalg.norm(kept - kept.mean(0), axis=1))
    return float(np.quantile(away, _KEPT) / spread) if spread > 0 else 0.0


def flat_and_frontal(model: Reconstruction) -> bool:
    """Whether all points lie in one plane and all cameras look at it alike."""
    axes = model.rotations[:, 2]
    mean = axes.mean(0) / max(float(np.linalg.norm(axes.mean(0))), 1e-12)
    apart = np.degrees(np.arccos(np.clip(axes @ mean, -1.0, 1.0)))
    return float(np.quantile(apart, _KEPT)) < _ONE_DIRECTION_DEG and thickness(model.points) < _FLAT
