"""The ladder of reconstructions: a step is tried only where none before it was accepted.

1. Triangulate the fine matches from the coarse poses, then two rounds of bundle adjustment and filtering, between which
   the photos are asked what they say of their lenses (`calibrated`).
2. Photos the coarse reconstruction missed: COLMAP's incremental mapper with the poses of 1 held, then 1 from its poses.
3. The incremental mapper from nothing on the same sparse graph, then 1 from its poses. Where it does not agree with the
   coarse reconstruction either, twice more from disjoint halves of the tracks, which share nothing but the photos.
4. More pairs (twice the nearest cameras, all look-alikes), and 1 to 3 again.
5. Where EXIF tells the focal length of every photo: a global reconstruction (GLOMAP, which failed 2 of 8 times), then 1
   from its poses.
6. Up to 150 photos: every pair there is, and 1 to 3 again.
"""

import dataclasses
from dataclasses import dataclass

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.acceptance import Agreement, agreement
from graphgs.structure.calibrated import calibrated
from graphgs.structure.contradictions import PairSupport
from graphgs.structure.halves import models_of_halves
from graphgs.structure.model_calls import ModelCalls
from graphgs.structure.more_pairs import every_pair, wider_pairs, with_more_pairs
from graphgs.structure.scale_across import ScaleAcross
from graphgs.structure.soundness import Soundness
from graphgs.structure.weak_places import disagreement, weak_places

_NEARLY_ALL = 0.8  # of the connected photos
_COMMON_SHARE = 0.5  # agreement on fewer of the photos says nothing about the rest
_MOST_FOR_EVERY_PAIR = 150  # photos


@dataclass(frozen=True)
class Candidate:
    """A reconstruction that a step of the ladder made, judged."""

    reconstruction: Reconstruction
    calls: ModelCalls  # that made it, with its matches
    name: str  # of its model in their scratch
    method: str
    other: Reconstruction | None  # that it was compared with
    agreement: Agreement | None
    compared_with: str
    accepted: bool
    soundness: Soundness
    support: PairSupport
    places: tuple[ScaleAcross, ...] = ()  # the weakest of it
    upheld: ScaleAcross | None = None  # the place where it was believed against the other reconstruction
    free: Reconstruction | None = None  # before its rigs became rigid

    @property
    def sound(self) -> bool:
        """Nothing speaks against it but, perhaps, that photos are missing."""
        return not self.soundness.doubts and not any(place.is_open for place in self.places)

    @property
    def rank(self) -> tuple[bool, int]:
        return self.accepted, len(self.reconstruction.names)


def climb(calls: ModelCalls, coarse: Reconstruction | None) -> Candidate | None:
    """The first reconstruction that is accepted, else the one with the most photos; None if there is none at all.

    `config.mapper` other than `ladder` takes one of COLMAP's own ways in place of all steps: a baseline."""
    ladder = _Ladder(coarse)
    mapper = calls.config.mapper
    if mapper == "incremental":
        ladder.judge(calls, calls.incremental(mapper), mapper, "incremental (COLMAP)")
    elif mapper == "global":
        ladder.judge(calls, calls.globally(mapper), mapper, "global (GLOMAP)")
    else:
        _climb(ladder, calls)
    return ladder.best


def _climb(ladder: "_Ladder", calls: ModelCalls) -> None:
    if ladder.steps(calls, ""):
        return
    wider = with_more_pairs(calls, "4_more_pairs", wider_pairs(calls.prior))
    most, note = (calls, "") if wider is None else (wider, ", more pairs")
    if ladder.steps(most, note):
        return
    if all(photo.focal_px for photo in calls.photos.photos):
        model = most.globally("5_global")
        if model is not None:
            most, model = calibrated(most, model, "5_adjusted")
        if ladder.judge(most, model, "5_adjusted", "global, focal lengths known"):
            return
    if len(calls.photos.photos) <= _MOST_FOR_EVERY_PAIR:
        everything = with_more_pairs(most, "6_every_pair", every_pair(calls.prior))
        if everything is not None:
            ladder.steps(everything, ", every pair")


class _Ladder:
    """The best reconstruction so far, and the steps that are climbed more than once."""

    def __init__(self, coarse: Reconstruction | None):
        self.best: Candidate | None = None
        self._coarse = coarse

    def judge(
        self,
        calls: ModelCalls,
        model: Reconstruction | None,
        name: str,
        method: str,
        other: Reconstruction | None = None,  # the coarse one, where there is one
        other_name: str = "the coarse reconstruction",
    ) -> bool:
        """Whether the best so far, this model included, is good enough."""
        if model is not None:
            found = judged(calls, model, name, method, other or self._coarse, other_name)
            if self.best is None or found.rank > self.best.rank:
                self.best = found
        return self.best is not None and self.best.accepted

    def steps(self, calls: ModelCalls, note: str) -> bool:
        """Steps 1 to 3 on the matches of `calls`. Not step 3 where nothing is wrong with the poses but that too few
        photos have one: then more pairs help, and mapping the same ones in the same way again does not."""
        first = None
        if self._coarse is not None:
            calls, first = calibrated(calls, self._coarse, "1_triangulated")
            if self.judge(calls, first, "1_triangulated", f"triangulated from coarse poses{note}"):
                return True
        if first is not None and len(first.names) < len(calls.matches.component):
            extended = calls.incremental("2_extended", start="1_triangulated")
            if extended is not None:
                calls, extended = calibrated(calls, extended, "2_adjusted")
            if self.judge(calls, extended, "2_adjusted", f"coarse poses, extended{note}"):
                return True
        if self._merely_incomplete(calls):
            return False
        model = calls.incremental("3_incremental")
        if model is not None:
            calls, model = calibrated(calls, model, "3_adjusted")
        if self.judge(calls, model, "3_adjusted", f"incremental{note}"):
            return True
        return model is not None and self._halves_agree(calls, model, note)

    def _merely_incomplete(self, calls: ModelCalls) -> bool:
        best = self.best
        if best is None or best.agreement is None or not best.sound:
            return False
        nearly_all = len(best.reconstruction.names) >= _NEARLY_ALL * len(calls.matches.component)
        return nearly_all and best.agreement.within(calls.config)

    def _halves_agree(self, calls: ModelCalls, model: Reconstruction, note: str) -> bool:
        """A second opinion on the incremental model: two more from disjoint halves of the tracks, which must agree with
        each other and with it."""
        halves = models_of_halves(calls, "3_half")
        if halves is None or not agreement(*halves).within(calls.config):
            return False
        least = min(halves, key=lambda half: len(half.names))
        return self.judge(
            calls,
            model,
            "3_adjusted",
            f"incremental, confirmed by both halves{note}",
            least,
            "half of the tracks alone",
        )


def judged(
    calls: ModelCalls,
    model: Reconstruction,
    name: str,
    method: str,
    other: Reconstruction | None,
    other_name: str,
) -> Candidate:
    """The model compared with another one of the same photos, made apart, and held against its matches."""
    config, component = calls.config, len(calls.matches.component)
    agreed, place = None, None
    sound, support = calls.witness.judge(model)
    places = weak_places(model, calls.witness)
    broken = tuple(place.describe() for place in places if place.jumps)
    sound = dataclasses.replace(sound, doubts=(*sound.doubts, *broken))
    if other is not None:
        agreed = agreement(other, model)
        if not agreed.within(config):
            place = disagreement(model, other, calls.witness, config)
    # The model stands where it alone places one side of a cut so: its own points, from either side alone, say that.
    upheld = place is not None and place.holds and not any(weak.is_open for weak in places)
    accepted = (
        agreed is not None
        and (agreed.within(config) or upheld)
        and not sound.doubts
        and len(model.names) >= config.min_registered * component
        and agreed.common >= _COMMON_SHARE * len(model.names)
    )
    confirmed = place if accepted and not agreed.within(config) else None
    figures = None if agreed is None else dataclasses.asdict(agreed)
    counts = {"registered": len(model.names), "component": component}
    objections = {"soundness": dataclasses.asdict(sound), "places": [dataclasses.asdict(place) for place in places]}
    calls.reporter.event("mapping", method=method, accepted=accepted, agreement=figures, **counts, **objections)
    compared_with = other_name if other is not None else ""
    return Candidate(
        model, calls, name, method, other, agreed, compared_with, accepted, sound, support, places, confirmed
    )
