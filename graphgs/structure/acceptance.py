"""Is a reconstruction right? Its own figures cannot tell: every wrong model measured had all photos registered and
under a pixel of error. Agreement of two reconstructions made apart, coarse and fine, told right from wrong 19 times."""

from dataclasses import dataclass

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import align_robust, diameter
from graphgs.structure.config import StructureConfig

_LARGEST_PAIR_SET = 500_000  # rotation changes looked at; more cameras are sampled


@dataclass(frozen=True)
class Agreement:
    """How far two reconstructions of the same photos differ, over the photos that both have."""

    common: int
    rotation_median_deg: float  # change of pairwise rotation
    rotation_p99_deg: float
    largest_shift: float  # of a camera, as a share of the scene's diameter, after robust alignment

    def within(self, config: StructureConfig) -> bool:
        return (
            self.common >= 3
            and self.rotation_median_deg < config.max_rotation_median_deg
            and self.rotation_p99_deg < config.max_rotation_p99_deg
            and self.largest_shift <= config.max_camera_shift
        )


def agreement(first: Reconstruction, second: Reconstruction) -> Agreement:
    """Compare by photo name; neither frame nor scale of the world matters."""
    row = {name: k for k, name in enumerate(second.names)}
    common = [(k, row[name]) for k, name in enumerate(first.names) if name in row]
    if len(common) < 3:
        return Agreement(len(common), np.inf, np.inf, np.inf)
    a, b = np.array(common).T
    changes = _rotation_changes(first.rotations[a], second.rotations[b])
    extent = diameter(first.centers[a])
    moved = align_robust(second.centers[b], first.centers[a]).apply(second.centers[b]) - first.centers[a]
    shift = float(np.linalg.norm(moved, axis=1).max() / extent) if extent > 0 else np.inf
    return Agreement(len(common), float(np.median(changes)), float(np.percentile(changes, 99)), shift)


def _rotation_changes(
    first: np.ndarray,  # [N, 3, 3]
    second: np.ndarray,  # [N, 3, 3]
) -> np.ndarray:
    """[P] degrees between R_j R_i^T of the one and of the other, for all pairs or a seeded sample of them."""
    i, j = np.triu_indices(len(first), 1)
    if len(i) > _LARGEST_PAIR_SET:
        sample = np.random.default_rng(0).choice(len(i), _LARGEST_PAIR_SET, replace=False)
        i, j = i[sample], j[sample]
    # trace(R_ij R'_ij^T) = <R_j^T R'_j, R_i^T R'_i>, so one change of frame per camera serves all its pairs.
    turned = np.einsum("nba,nbc->nac", first, second).reshape(-1, 9)
    cosine = (np.einsum("pk,pk->p", turned[i], turned[j]) - 1.0) / 2.0
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
