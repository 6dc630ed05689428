"""With which other views a view is compared to find its depths."""

import numpy as np
from scipy import sparse

from graphgs.scene.reconstruction import Reconstruction

BEST_ANGLE_DEG = 5.0  # between two rays: below, depth is vague; above, surfaces look different
NARROWER_DEG, WIDER_DEG = 1.0, 10.0  # how fast a pair loses worth to both sides
FEWEST_SHARED = 8  # points of a pair


def sweep_partners(
    reconstruction: Reconstruction,
    usable: np.ndarray,  # [N] bool: training images; no other is a partner or gets one
    count: int,
) -> list[np.ndarray]:
    """For each image at most `count` others, best first: those that share many points under good angles (the score of
    MVSNet, Yao et al. 2018). Empty for images that are not usable, and where nothing is shared."""
    n, points = len(reconstruction.names), reconstruction.points
    point = np.repeat(np.arange(len(points)), reconstruction.track_lengths)
    used = usable[reconstruction.track_images]
    image, point = reconstruction.track_images[used], point[used]
    seen = sparse.csr_matrix((np.ones(len(point), np.int32), (image, point)), shape=(n, len(points)))
    seen.data[:] = 1
    shared = sparse.triu(seen @ seen.T, k=1).tocoo()
    enough = shared.data >= FEWEST_SHARED
    scores: list[list[tuple[float, int]]] = [[] for _ in range(n)]
    for i, j in zip(shared.row[enough], shared.col[enough], strict=True):
        both = np.intersect1d(seen[i].indices, seen[j].indices, assume_unique=True)
        worth = float(_worth(points[both] - reconstruction.centers[i], points[both] - reconstruction.centers[j]))
        scores[i].append((-worth, int(j)))
        scores[j].append((-worth, int(i)))
    return [np.array([j for worth, j in sorted(of_image)[:count] if worth < 0], dtype=int) for of_image in scores]


def _worth(
    from_i: np.ndarray,  # [P, 3] rays to shared points
    from_j: np.ndarray,  # [P, 3]
) -> float:
    cosine = (from_i * from_j).sum(1) / np.linalg.norm(from_i, axis=1) / np.linalg.norm(from_j, axis=1)
    off = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))) - BEST_ANGLE_DEG
    return float(np.exp(-0.5 * (off / np.where(off <= 0, NARROWER_DEG, WIDER_DEG)) ** 2).sum())
