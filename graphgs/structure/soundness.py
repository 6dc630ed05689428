"""What speaks against a reconstruction although it agrees with another one: both may be wrong in the same way.

Limits lie between what was measured on sound models of five real sets and a rendered street (contradicted share at most
.03, strength at most .19, turns explaining .11) and on wrong ones that agreed with each other (strength .88 and more,
turns explaining .94); docs/decisions/0021-diagnosis.md has the table.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.structure.cameras import SharedCameras
from graphgs.structure.contradictions import PairSupport, support_of
from graphgs.structure.evidence import VerifiedMatches, read_verified
from graphgs.structure.flatness import flat_and_frontal
from graphgs.structure.rotation_only import RotationFit, fit_rotations

LARGEST_SHARE = 0.1  # of matches that contradict the model
LARGEST_STRENGTH = 0.4  # of a pair that does, see PairSupport.strength
_FEWEST_POINTS = 5  # per photo


@dataclass(frozen=True)
class Soundness:
    """The figures, and the doubts they raise; without doubts the model may be believed."""

    contradicted_share: float
    strength: float  # of the pair that contradicts the model most
    pair: tuple[str, str] | None  # that pair
    pair_matches: int  # its contradicted matches
    rotation_share: float  # of the pairs that a turn of the camera alone explains
    flat: bool  # one plane, seen from one direction
    points: int
    doubts: tuple[str, ...]  # for people


@dataclass(frozen=True)
class Witness:
    """The verified matches of a set of photos, and what they say before there is any model."""

    photos: Photos
    verified: VerifiedMatches
    rotation: RotationFit
    min_inliers: int  # verified matches below which a pair does not count

    @staticmethod
    def of(photos: Photos, database: Path, cameras: SharedCameras, *, min_inliers: int) -> "Witness":
        verified = read_verified(database)
        told = all(photo.focal_px for photo in photos.photos)
        return Witness(photos, verified, fit_rotations(verified, cameras, focal_known=told), min_inliers)

    def judge(self, model: Reconstruction) -> tuple[Soundness, PairSupport]:
        """The model by the matches it was made from."""
        support = support_of(model, self.photos.names, self.verified)
        strength = support.objections(self.min_inliers)
        worst = int(strength.argmax()) if len(strength) else -1
        pair = None if worst < 0 or strength[worst] == 0 else tuple(model.names[k] for k in support.pairs[worst])
        figures = {
            "contradicted_share": support.contradicted_share,
            "strength": 0.0 if pair is None else float(strength[worst]),
            "pair": pair,
            "pair_matches": 0 if pair is None else int(support.contradicted[worst]),
            "rotation_share": self.rotation.share,
            "flat": flat_and_frontal(model),
            "points": len(model.points),
        }
        return Soundness(**figures, doubts=tuple(_doubts(figures, model, self.photos, self.rotation))), support

    def objections(self, support: PairSupport) -> np.ndarray:
        """[K, 2] the pairs that contradict the model strongly enough to doubt it."""
        return support.pairs[support.objections(self.min_inliers) >= LARGEST_STRENGTH]


def _doubts(figures: dict, model: Reconstruction, photos: Photos, rotation: RotationFit):
    if figures["points"] < _FEWEST_POINTS * len(model.names):
        yield f"hardly any points were found: {figures['points']} for {len(model.names)} photos"
    if rotation.on_the_spot:
        yield rotation.describe()
    if figures["strength"] >= LARGEST_STRENGTH:
        first, second = figures["pair"]
        yield (
            f"{first} and {second} share {figures['pair_matches']} matches that the poses contradict: parts of the "
            "scene look alike, and one may have been taken for another"
        )
    elif figures["contradicted_share"] >= LARGEST_SHARE:
        yield (
            f"{100 * figures['contradicted_share']:.0f} % of the matches contradict the poses: parts of the scene look "
            "alike, and one may have been taken for another"
        )
    told = {photo.name for photo in photos.photos if photo.focal_px}
    if figures["flat"] and not told.issuperset(model.names):
        yield (
            "all is in one plane and seen from one direction, which leaves the focal length open; tell it with "
            "--set sources.focal_px=PIXELS, or add photos from the side"
        )
