"""Similarity transforms: least-squares alignment of two sets of camera centres, and a robust spread of a set."""

import contextlib
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Similarity:
    """y = scale * rotation @ x + translation."""

    scale: float
    rotation: np.ndarray  # [3, 3]
    translation: np.ndarray  # [3]

    def apply(self, points: np.ndarray) -> np.ndarray:
        return self.scale * points @ self.rotation.T + self.translation


def align(
    source: np.ndarray,  # [N, 3]
    target: np.ndarray,  # [N, 3]
) -> Similarity:
    """The similarity that carries `source` onto `target` with least squared error (Umeyama 1991)."""
    mean_s, mean_t = source.mean(0), target.mean(0)
    s, t = source - mean_s, target - mean_t
    u, d, vt = np.linalg.svd(t.T @ s / len(s))
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt)) or 1.0])
    rotation = u @ sign @ vt
    variance = (s**2).sum() / len(s)
    scale = float((d * np.diag(sign)).sum() / variance) if variance > 0 else 1.0
    return Similarity(scale, rotation, mean_t - scale * rotation @ mean_s)


def align_robust(
    source: np.ndarray,  # [N, 3]
    target: np.ndarray,  # [N, 3]
    *,
    seed: int = 0,
    trials: int = 200,
) -> Similarity:
    """Alignment that a minority of wrong cameras cannot spoil: the three-camera sample with the least median error,
    refitted on the cameras within three times that median."""
    if len(source) <= 3:
        return align(source, target)
    rng = np.random.default_rng(seed)
    best, best_error = align(source, target), np.inf
    candidates = [best]
    candidates += [
        align(source[sample], target[sample])
        for sample in (rng.choice(len(source), 3, replace=False) for _ in range(trials))
    ]
    for candidate in candidates:
        error = float(np.median(np.linalg.norm(candidate.apply(source) - target, axis=1)))
        if error < best_error:
            best, best_error = candidate, error
    residual = np.linalg.norm(best.apply(source) - target, axis=1)
    inlier = residual <= max(3.0 * best_error, 1e-12)
    return align(source[inlier], target[inlier]) if inlier.sum() >= 3 else best


def diameter(points: np.ndarray) -> float:
    """Largest distance between any two of [N, 3] points, exact (position errors are quoted in % of it)."""
    from scipy.spatial import ConvexHull, QhullError
    from scipy.spatial.distance import pdist

    if len(points) < 2:
        return 0.0
    if len(points) > 500:
        with contextlib.suppress(QhullError):  # a line or a plane of cameras: all pairs, below
            points = points[ConvexHull(points).vertices]
    return float(pdist(points).max())
