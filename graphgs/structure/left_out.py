"""Why a photo has no pose: one cause each, from what is known of it beside the photos that have one."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from graphgs.structure.edge_width import blur_words
from graphgs.structure.sharpness import Sharpness

Cause = Literal[
    "blur", "texture", "crash", "no overlap", "tiny group", "another group", "repetition", "triangulation", "pose"
]  # fmt: skip

# Limits relative to the photos that were placed: a share of their median, and at least three of their own deviations.
_BLUR = 0.4  # of the sharpness, while the contrast is that of a photo of something
_CONTRAST = 0.25
_TEXTURE = 0.2  # of the features
# By itself: 15 verified matches make a pair, and of photos that overlap by half one feature in four finds its match.
FEWEST_FEATURES = 60
_DEVIATIONS = 3.0
_GAUSSIAN = 1.4826  # standard deviation of a normal distribution, in medians of its absolute values
_FEWEST_PARTNERS = 4  # to tell that they do not belong together
_MUTUAL = 0.35  # share of a photo's partners that match each other: a place seen from all sides has more than half
_FEWEST_SEEN = 30  # triangulated points that a pose can be found from (COLMAP's default)


@dataclass(frozen=True)
class PhotoEvidence:
    """What is known of every photo. NaN: not measured."""

    names: tuple[str, ...]  # [N]
    placed: np.ndarray  # [N] bool
    group: np.ndarray  # [N] int, connected group: 0 = the kept one
    sharp: Sharpness  # [N]
    features: np.ndarray  # [N]
    tried: np.ndarray  # [N] pairs matched
    verified: np.ndarray  # [N] pairs verified
    closest: np.ndarray  # [N] most features matched in a pair that did not verify
    mutual: np.ndarray  # [N] share of the pairs among its verified partners that are verified themselves
    seen: np.ndarray  # [N] verified matches with features that have a triangulated point
    crashes: dict[str, str] = field(default_factory=dict)  # photo -> what came of matching it


@dataclass(frozen=True)
class LeftOut:
    """A photo without a pose."""

    name: str
    cause: Cause
    reason: str  # for people


def left_out(evidence: PhotoEvidence) -> tuple[LeftOut, ...]:
    """Every photo that was not placed, with the first cause that applies: what is wrong with the photo itself, then
    what it lacks of others, then what the reconstruction lacks."""
    missing = (int(k) for k in np.flatnonzero(~evidence.placed))
    return tuple(LeftOut(evidence.names[k], *(_own_fault(evidence, k) or _no_place(evidence, k))) for k in missing)


def _own_fault(evidence: PhotoEvidence, k: int) -> tuple[Cause, str] | None:
    name, sharp = evidence.names[k], evidence.sharp
    if name in evidence.crashes:
        return "crash", evidence.crashes[name]
    sharpness, contrast = _beside(evidence, sharp.sharpness, k), _beside(evidence, sharp.contrast, k)
    if sharpness.below(_BLUR) and contrast.share >= _CONTRAST:
        return "blur", f"blurred: its edges are {100 * sharpness.share:.0f} % as sharp as the other photos'"
    if sharp.blurred[k]:
        return "blur", blur_words(sharp.edge_px[k])
    features = _beside(evidence, evidence.features, k)
    if features.below(_TEXTURE):
        return "texture", f"too little texture: {features.own:.0f} features, the others have {features.typical:.0f}"
    if evidence.features[k] < FEWEST_FEATURES:
        return "texture", f"too little texture: {evidence.features[k]:.0f} features, {FEWEST_FEATURES} are needed"
    return None


def _no_place(evidence: PhotoEvidence, k: int) -> tuple[Cause, str]:
    members = np.flatnonzero(evidence.group == evidence.group[k])
    tried, verified, seen = (int(array[k]) for array in (evidence.tried, evidence.verified, evidence.seen))
    if len(members) == 1:
        closest = f"; the closest has {evidence.closest[k]} matches that fit no geometry" if evidence.closest[k] else ""
        return "no overlap", f"no overlap: none of the {tried} pairs tried with it shares a view{closest}"
    if evidence.group[k] and len(members) == 2:
        partner = evidence.names[int(members[members != k][0])]
        return "tiny group", f"shares features with {partner} alone"
    if evidence.group[k]:
        first, last = evidence.names[int(members[0])], evidence.names[int(members[-1])]
        return "another group", f"belongs to {len(members)} photos apart from the main group: {first} to {last}"
    main = f"shares features with {verified} photos of the main group"
    if verified >= _FEWEST_PARTNERS and evidence.mutual[k] < _MUTUAL:
        return "repetition", f"ambiguous: {main} that mostly do not match each other: parts of the scene look alike"
    if seen < _FEWEST_SEEN:
        return "triangulation", f"{main}, but sees only {seen} points whose distance is known: taken too close together"
    return "pose", f"{main}, but no pose fits them"


@dataclass(frozen=True)
class _Beside:
    """A value beside those of the placed photos."""

    own: float
    typical: float  # their median
    deviation: float  # theirs, robustly, of the logarithm

    @property
    def share(self) -> float:
        return self.own / self.typical if self.typical > 0 else np.inf

    def below(self, share: float) -> bool:
        """Below that share of the median, and unusual among them. False where nothing is known."""
        return bool(self.share < share and np.log(max(self.share, 1e-9)) < -_DEVIATIONS * self.deviation)


def _beside(evidence: PhotoEvidence, values: np.ndarray, k: int) -> _Beside:
    others = values[evidence.placed & np.isfinite(values)]
    if not len(others) or not np.isfinite(values[k]):
        return _Beside(1.0, 1.0, 0.0)
    typical = float(np.median(others))
    logs = np.log(np.maximum(others, 1e-9) / max(typical, 1e-9))
    return _Beside(float(values[k]), typical, _GAUSSIAN * float(np.median(np.abs(logs))))
