"""A reconstruction held against its matches where it is weakest, and where another reconstruction disagrees with it."""

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import align_robust, diameter
from graphgs.structure.acceptance import agreement
from graphgs.structure.config import StructureConfig
from graphgs.structure.cuts import weakest_cuts
from graphgs.structure.scale_across import MatchedPoints, ScaleAcross, scale_across
from graphgs.structure.soundness import Witness

_MOST_APART = 0.5  # of the photos may lie elsewhere in the other reconstruction


def weak_places(model: Reconstruction, witness: Witness) -> tuple[ScaleAcross, ...]:
    """The weakest places that points are seen across, with what those say of scale and bearing."""
    matched = MatchedPoints.of(model, witness.photos.names, witness.verified)
    found = (scale_across(model, matched, side) for side in weakest_cuts(model))
    return tuple(place for place in found if place is not None)


def disagreement(
    model: Reconstruction, other: Reconstruction, witness: Witness, config: StructureConfig
) -> ScaleAcross | None:
    """What the model's own points say about the place where another reconstruction of the same photos parts from it:
    between the photos that lie alike in both and the rest. None where most lie elsewhere, or none."""
    row = {name: k for k, name in enumerate(other.names)}
    common = np.array([k for k, name in enumerate(model.names) if name in row], np.int64)
    if len(common) < 3:
        return None
    theirs = other.centers[[row[model.names[k]] for k in common]]
    moved = align_robust(theirs, model.centers[common]).apply(theirs) - model.centers[common]
    apart = np.linalg.norm(moved, axis=1) > config.max_camera_shift * diameter(model.centers)
    if not 0 < apart.sum() <= _MOST_APART * len(common):
        return None
    near = {model.names[k] for k in common[~apart]}
    agreed = agreement(_of(other, near), _of(model, near))  # their places do, by choice
    if (
        agreed.rotation_median_deg >= config.max_rotation_median_deg
        or agreed.rotation_p99_deg >= config.max_rotation_p99_deg
    ):
        return None  # they differ elsewhere, too
    side = np.zeros(len(model.names), bool)
    side[common[apart]] = True
    return scale_across(model, MatchedPoints.of(model, witness.photos.names, witness.verified), side)


def _of(model: Reconstruction, names: set[str]) -> Reconstruction:
    """The poses of some photos alone."""
    rows = [k for k, name in enumerate(model.names) if name in names]
    return Reconstruction(
        cameras=model.cameras,
        names=tuple(model.names[k] for k in rows),
        camera_ids=model.camera_ids[rows],
        rotations=model.rotations[rows],
        translations=model.translations[rows],
    )
