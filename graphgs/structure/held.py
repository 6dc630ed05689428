"""Poses that came with the input, held against the photos before anything is built on them."""

import functools
from pathlib import Path

import numpy as np

from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.config import SourcesConfig
from graphgs.sources.photos import Photos
from graphgs.structure.config import StructureConfig
from graphgs.structure.evidence import VerifiedMatches
from graphgs.structure.feature_cache import FeatureCache
from graphgs.structure.given_evidence import MatchedRays
from graphgs.structure.given_matches import independent_matches
from graphgs.structure.given_mistakes import Mistake, usual_mistakes
from graphgs.structure.given_points import photos_astray, share_misplaced, track_errors
from graphgs.structure.given_sample import sample, sampled
from graphgs.structure.given_verdict import ASTRAY, FITS, MISPLACED, REFUSED_MISPLACED, Figures, HeldPoses, Verdict

_MUCH_BETTER = 0.5  # of what contradicts the poses, at most, with a mistake undone that is named as the cause
_NEAR = "use --poses refine, which adjusts them to the photos"
_ELSEWHERE = "use --poses prior, which finds our own and lets these choose pairs alone"
_DROP = "use --set sources.given_points=drop, and points are triangulated from the poses"


def hold_given(
    config: StructureConfig,
    settings: SourcesConfig,  # that the poses were read with
    photos: Photos,  # with given poses
    *,
    scratch: Path,
    reporter: Reporter,
    threads: int,
    cache: FeatureCache | None = None,
) -> HeldPoses:
    """Whether the given poses, and the points that came with them, fit what a sample of the photos shows; and where
    they do not, whether undoing one of the usual mistakes would make them. `graphgs check` asks the same."""
    given = photos.given
    chosen = sample(given.names, given.centers)
    some = sampled(photos, chosen)
    verified = independent_matches(config, some, scratch=scratch, reporter=reporter, threads=threads, cache=cache)
    sides = np.array([max(photo.original_width, photo.original_height) for photo in some.photos])
    evidence = _Evidence(given, chosen, verified, sides, keeps_points=config.poses == "keep")
    held = evidence.judged(list(usual_mistakes(given.names, photos.given_axes, settings)))
    reporter.event("given", **held.record())
    return held


class _Evidence:
    """What given poses are tried on."""

    def __init__(
        self,
        given: Reconstruction,
        chosen: np.ndarray,  # [S] int into its names
        verified: VerifiedMatches,  # counts the chosen
        sides_px: np.ndarray,  # [S]
        *,
        keeps_points: bool,  # else points are triangulated anew, and poses refined
    ):
        self._given, self._chosen, self._verified, self._sides = given, chosen, verified, sides_px
        self._keeps_points = keeps_points

    def judged(self, mistakes: list[Mistake]) -> HeldPoses:
        model = self._given.of_images(self._chosen)
        matched = MatchedRays(model, self._verified, self._sides)
        errors = matched.errors(model)
        matches, observations = Figures.of(errors, matched.astray), self._observed(model)
        medians = matched.pair_medians(errors)[np.bincount(matched.pair_of, minlength=len(matched.pairs)) > 0]
        judge = matches or observations
        poses: Verdict = "open" if judge is None else judge.verdict(to_refine=not self._keeps_points)
        mistake = None
        if judge is not None and judge.verdict() != "fits":
            mistake = self._best(mistakes, judge)
            poses = poses if mistake is None else "refused"
        points, misplaced = self._points(model, matched, observations, poses, judged_by_matches=matches is not None)
        return HeldPoses(
            photos=len(self._chosen),
            posed=len(self._given.names),
            pairs=len(self._verified.pairs),
            worst_pair_px=_tenth_worst(medians, self._sides),
            matches=matches,
            observations=observations,
            misplaced=misplaced,
            poses=poses,
            points=points,
            fits="" if mistake is None else mistake.fits,
            mend=_mend(mistake, poses, points, judge),
        )

    def _best(self, mistakes: list[Mistake], judge: Figures) -> Mistake | None:
        """The mistake that, undone, leaves least to contradict the poses; None unless they fit then, or nearly every
        photo finds its neighbours where hardly one did."""
        found = [self._without(mistake) for mistake in mistakes]
        best = min(range(len(found)), key=lambda k: found[k].contradicted)
        fits = found[best].contradicted < min(FITS, _MUCH_BETTER * judge.contradicted)
        return mistakes[best] if fits or (found[best].repeated and judge.astray > 1 - ASTRAY) else None

    def _without(self, mistake: Mistake) -> Figures:
        model = mistake.undo(self._given).of_images(self._chosen)
        matched = MatchedRays(model, self._verified, self._sides)
        return Figures.of(matched.errors(model), matched.astray) or self._observed(model)

    def _observed(self, model: Reconstruction) -> Figures | None:
        errors = track_errors(model, self._sides)
        return Figures.of(errors, functools.partial(photos_astray, model))

    def _points(
        self,
        model: Reconstruction,
        matched: MatchedRays,
        observations: Figures | None,
        poses: Verdict,
        *,
        judged_by_matches: bool,
    ) -> tuple[Verdict, float | None]:
        """(verdict, share misplaced) of the points; wrong poses say nothing about them."""
        if not (self._keeps_points and len(model.points)) or poses == "refused":
            return "open", None
        if observations is not None:
            return observations.verdict() if judged_by_matches else "open", None
        share = share_misplaced(model, matched.sightings(model), len(self._given.names))
        if share is None:
            return "open", None
        return "refused" if share >= REFUSED_MISPLACED else "doubtful" if share >= MISPLACED else "fits", share


def _mend(mistake: Mistake | None, poses: Verdict, points: Verdict, judge: Figures | None) -> str:
    if mistake is not None:
        return mistake.mend
    if poses in ("doubtful", "refused"):
        return _NEAR if judge.far_off < FITS else "" if judge.verdict() == "doubtful" and judge.repeated else _ELSEWHERE
    return _DROP if points in ("doubtful", "refused") else ""


def _tenth_worst(medians: np.ndarray, sides_px: np.ndarray) -> float:
    """[px] that nine of ten pairs stay below in the median."""
    return float(np.percentile(medians, 90) * np.median(sides_px)) if len(medians) else 0.0
