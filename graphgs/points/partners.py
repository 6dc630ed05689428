"""With which other views a view is compared to find its depths."""

import numpy as np
from scipy import sparse

from graphgs.scene.reconstruction import Reconstruction

BEST_ANGLE_DEG = 5.0  # between two rays: below, depth is vague; above, surfaces look different
NARROWER_DEG, WIDER_DEG = 1.0, 10.0  # how fast a pair loses worth to both sides
FEWEST_SHARED = 8  # points of a pair
LEAST_WORTH = 3e-3  # of a shared point, on average: photos from one place look alike on every plane and tell nothing


def sweep_partners(
    reconstruction: Reconstruction,
    usable: np.ndarray,  # [N] bool: training images; no other is a partner or gets one
    count: int,
) -> list[np.ndarray]:
    """For each image at most `count` others, best first: those that share many points under good angles (the score of
    MVSNet, Yao et al. 2018). Empty for images that are not usable, and where nothing is shared."""
    n, points, centers = len(reconstruction.names), reconstruction.points, reconstruction.centers
    point = np.repeat(np.arange(len(points)), reconstruction.track_lengths)
    used = usable[reconstruction.track_images]
    image, point = reconstruction.track_images[used], point[used]
    seen = sparse.csr_matrix((np.ones(len(point), np.int32), (image, point)), shape=(n, len(points)))
    seen_by = seen.T.tocsr()
    partners = []
    for i in range(n):
        own = seen[i].indices
        pairs = seen_by[own].tocoo()  # (of the image's points, another image that sees it)
        rays = points[own] - centers[i]
        worths = _worths(rays[pairs.row], points[own][pairs.row] - centers[pairs.col])
        shared = np.bincount(pairs.col, minlength=n)
        worth = np.bincount(pairs.col, weights=worths, minlength=n)
        good = (shared >= FEWEST_SHARED) & (worth > LEAST_WORTH * shared)
        good[i] = False
        chosen = np.flatnonzero(good)
        partners.append(chosen[np.argsort(-worth[chosen], kind="stable")][:count])
    return partners


def _worths(
    from_i: np.ndarray,  # [P, 3] rays to shared points
    from_j: np.ndarray,  # [P, 3]
) -> np.ndarray:  # [P]
    lengths = np.linalg.norm(from_i, axis=1) * np.linalg.norm(from_j, axis=1)
    cosine = (from_i * from_j).sum(1) / np.maximum(lengths, 1e-300)
    off = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))) - BEST_ANGLE_DEG
    return np.exp(-0.5 * (off / np.where(off <= 0, NARROWER_DEG, WIDER_DEG)) ** 2)
