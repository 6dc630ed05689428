"""Focal lengths of photos that do not tell theirs, by vote of the fundamental matrices of their matches.

With the right focal length f, K^T F K has two equal singular values (it is an essential matrix). How far they are
apart is averaged over all pairs and scanned over f: the minimum is the focal length, and its sharpness says whether the
photos determine one at all. Straight driving does not: any f fits, bundle adjustment would wander off, so f is held.
"""

from dataclasses import dataclass

import numpy as np

TYPICAL_FOCAL = 26 / 36  # of the longer side: the 26 mm equivalent of phone, action and drone cameras
_SCALES = np.geomspace(0.4, 3.0, 81)  # of the starting focal length
_FEWEST_PAIRS = 3  # to decide, given a sharp minimum
_FEWEST_PAIRS_FLAT = 10  # to call the vote flat
_FEWEST_INLIERS = 30
_CAP = 0.3  # of a pair's cost: a wrong F must not outvote the rest
_FLOOR = 0.005  # cost of a fundamental matrix without error but for noise
_CONTRAST = 1.5  # the cost grows at least so much when f doubles or halves, else the photos do not determine f


@dataclass(frozen=True)
class FocalVote:
    scale: float  # of the starting focal lengths; 1 where undecided
    decided: bool
    flat: bool  # enough pairs voted, and any focal length fits them: the photos do not determine it
    pairs: int  # that voted


def vote_focal(
    fundamentals: np.ndarray,  # [P, 3, 3] of x_j^T F x_i = 0, px
    inliers: np.ndarray,  # [P]
    intrinsics_i: np.ndarray,  # [P, 3, 3] with the starting focal length
    intrinsics_j: np.ndarray,  # [P, 3, 3]
) -> FocalVote:
    """One factor for the focal lengths of all pairs."""
    strong = inliers >= _FEWEST_INLIERS
    F, weight = fundamentals[strong], np.sqrt(inliers[strong].astype(float))
    K_i, K_j = intrinsics_i[strong], intrinsics_j[strong]
    if len(F) < _FEWEST_PAIRS:
        return FocalVote(1.0, False, False, len(F))
    cost = np.array([np.average(_asymmetry(F, K_i, K_j, s), weights=weight) for s in _SCALES]) + _FLOOR
    best = int(cost.argmin())
    step = np.log(_SCALES[1] / _SCALES[0])
    octave = round(np.log(2.0) / step)
    # At the edge of the scan the side that is cut off cannot object.
    sides = [cost[k] / cost[best] for k in (best - octave, best + octave) if 0 <= k < len(cost)]
    if not sides or min(sides) < _CONTRAST or best in (0, len(cost) - 1):
        return FocalVote(1.0, False, len(F) >= _FEWEST_PAIRS_FLAT, len(F))
    left, middle, right = cost[best - 1 : best + 2]
    bend = left - 2 * middle + right
    shift = 0.5 * (left - right) / bend if bend > 0 else 0.0
    return FocalVote(float(np.exp(np.log(_SCALES[best]) + shift * step)), True, False, len(F))


def _asymmetry(F: np.ndarray, K_i: np.ndarray, K_j: np.ndarray, scale: float) -> np.ndarray:
    """[P] 1 - s2 / s1 of the would-be essential matrices, capped."""
    zoom = np.diag([scale, scale, 1.0])
    singular = np.linalg.svd((K_j @ zoom).transpose(0, 2, 1) @ F @ (K_i @ zoom), compute_uv=False)
    return np.minimum(1.0 - singular[:, 1] / np.maximum(singular[:, 0], 1e-300), _CAP)
