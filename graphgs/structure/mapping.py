"""Final camera poses: a ladder of reconstructions, each step tried only where the one before was not accepted.

1. Triangulate the fine matches from the coarse poses, then two rounds of bundle adjustment and filtering.
2. Photos the coarse reconstruction missed: COLMAP's incremental mapper with the poses of 1 held, then 1 from its poses.
3. The incremental mapper from nothing on the same sparse graph, with two seeds, then 1 from its poses.

Cameras that prove to be fixed on a rig get one place on it in a last bundle adjustment. Last of all the world gets its
units and axes, where GPS or a rig's known baseline gives them.
"""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.structure.acceptance import Agreement, agreement
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.colors import colored
from graphgs.structure.config import StructureConfig
from graphgs.structure.given import map_given
from graphgs.structure.matching import Matches
from graphgs.structure.model_calls import ModelCalls
from graphgs.structure.prior import Prior
from graphgs.structure.result import Structure, edges_among, left_out
from graphgs.structure.rig_refinement import constrained, rig_poses
from graphgs.structure.rigs import RigPose
from graphgs.structure.world import WorldFrame, plain, settled

_ANOTHER_SEED = 1000  # offset
_COMMON_SHARE = 0.5  # agreement on fewer of the photos says nothing about the rest


@dataclass(frozen=True)
class _Candidate:
    """A reconstruction that a step of the ladder made, judged."""

    reconstruction: Reconstruction
    name: str  # of its model in scratch
    method: str
    other: Reconstruction | None  # that it was compared with
    agreement: Agreement | None
    compared_with: str
    accepted: bool
    free: Reconstruction | None = None  # before its rigs became rigid

    @property
    def rank(self) -> tuple[bool, int]:
        return self.accepted, len(self.reconstruction.names)


def map_fine(
    config: StructureConfig,
    photos: Photos,
    matches: Matches,
    prior: Prior,
    *,
    scratch: Path,
    reporter: Reporter,
    threads: int,
    seed: int,
) -> Structure:
    """Climb the ladder until a reconstruction is accepted; else the best there is, not accepted. A prior of given poses
    leads to `map_given` instead.

    Each mapping call leaves its model in `scratch`: a killed run repeats at most one. Raises DataError when nothing
    could be reconstructed."""
    if prior.source == "given":
        return map_given(config, photos, matches, prior, scratch=scratch, reporter=reporter, threads=threads, seed=seed)
    component = matches.component
    with ColmapWorker(scratch) as worker:
        mapper = ModelCalls(config, photos, matches, prior, worker, scratch, reporter, threads, seed)
        best = _climb(config, mapper, prior.reconstruction, len(component), reporter)
        if best is not None and photos.rigs and config.rig_refinement == "constrained":
            best = _mounted(config, mapper, best, len(component), reporter)
        reporter.event("worker", stage="mapping", peak_rss_mb=round(worker.peak_rss_mb))
    if best is None:
        raise DataError(
            f"the matches of {len(component)} connected photos gave no reconstruction",
            hint="photos must be taken from different places (not turned on the spot) and overlap by half or more",
        )
    reconstruction, rigs, world = _settled(config, best, photos, prior, reporter)
    reconstruction = colored(reconstruction, photos, threads=threads)
    edges, inliers = edges_among(matches, reconstruction.names)
    return Structure(
        reconstruction,
        edges,
        inliers,
        best.accepted,
        best.method,
        best.agreement,
        best.compared_with,
        len(component),
        left_out(photos.names, reconstruction.names, component, matches.edges),
        rigs,
        world,
    )


def _climb(
    config: StructureConfig, mapper: ModelCalls, coarse: Reconstruction | None, component: int, reporter: Reporter
) -> _Candidate | None:
    best: _Candidate | None = None

    def judge(
        model: Reconstruction | None, name: str, method: str, other: Reconstruction | None, other_name: str
    ) -> bool:
        """Whether the best so far is good enough; `model` has been compared with `other`."""
        nonlocal best
        if model is not None:
            found = _judged(config, model, name, method, other, other_name, component, reporter)
            if best is None or found.rank > best.rank:
                best = found
        return best is not None and best.accepted

    first = None
    if coarse is not None:
        first = mapper.triangulated(coarse, "1_triangulated")
        judge(first, "1_triangulated", "triangulated from coarse poses", coarse, "the coarse reconstruction")
    if first is not None and len(first.names) < component:
        extended = mapper.incremental("2_extended", start="1_triangulated")
        if extended is not None:
            extended = mapper.triangulated(extended, "2_adjusted")
        judge(extended, "2_adjusted", "coarse poses, extended", coarse, "the coarse reconstruction")
    if best is not None and best.accepted:
        return best
    models = []
    for offset in (0, _ANOTHER_SEED):
        model = mapper.incremental(f"3_incremental_{offset}", seed_offset=offset)
        if model is not None:
            model = mapper.triangulated(model, f"3_adjusted_{offset}")
        if judge(model, f"3_adjusted_{offset}", "incremental", coarse, "the coarse reconstruction"):
            return best
        models.append((model, f"3_adjusted_{offset}"))
    if all(model is not None for model, _ in models):
        (larger, name), (other, _) = sorted(models, key=lambda m: -len(m[0].names))
        judge(larger, name, "incremental, two seeds", other, "the same with another seed")
    return best


def _judged(
    config: StructureConfig,
    model: Reconstruction,
    name: str,
    method: str,
    other: Reconstruction | None,
    other_name: str,
    component: int,
    reporter: Reporter,
) -> _Candidate:
    agreed, accepted = None, False
    if other is not None:
        agreed = agreement(other, model)
        accepted = (
            agreed.within(config)
            and len(model.names) >= config.min_registered * component
            and agreed.common >= _COMMON_SHARE * len(model.names)
        )
    figures = None if agreed is None else dataclasses.asdict(agreed)
    counts = {"registered": len(model.names), "component": component}
    reporter.event("mapping", method=method, accepted=accepted, agreement=figures, **counts)
    return _Candidate(model, name, method, other, agreed, other_name, accepted)


def _mounted(
    config: StructureConfig, mapper: ModelCalls, best: _Candidate, component: int, reporter: Reporter
) -> _Candidate:
    """The candidate with its rigs rigid, if that is no worse."""
    model = constrained(mapper, best.name, best.reconstruction, reporter)
    if model is None:
        return best
    method = f"{best.method}, rig constrained"
    found = _judged(config, model, best.name, method, best.other, best.compared_with, component, reporter)
    return dataclasses.replace(found, free=best.reconstruction) if found.rank >= best.rank else best


def _settled(
    config: StructureConfig, best: _Candidate, photos: Photos, prior: Prior, reporter: Reporter
) -> tuple[Reconstruction, tuple[RigPose, ...], WorldFrame | None]:
    """The reconstruction in its final frame, with what is known about it said."""
    poses = rig_poses(photos, best.reconstruction, best.free)
    reconstruction, poses, world, trouble = settled(best.reconstruction, prior, poses, baseline_m=config.rig_baseline_m)
    for pose in poses:
        reporter.event("rig", **pose.record())
        reporter.info(pose.describe("m" if world is not None else ""))
    if trouble:
        reporter.warn(trouble)
    if world is not None:
        reporter.event("world", **plain(world))
        reporter.info(world.describe())
    return reconstruction, poses, world
