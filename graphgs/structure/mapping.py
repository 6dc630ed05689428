"""Final camera poses: the ladder of reconstructions (`ladder`), then what is known about rigs and the world.

Cameras that prove to be fixed on a rig get one place on it in a last bundle adjustment. Last of all the world gets its
units and axes, where GPS or a rig's known baseline gives them.
"""

import dataclasses
from pathlib import Path

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import diameter
from graphgs.sources.photos import Photos
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.colors import colored
from graphgs.structure.config import StructureConfig
from graphgs.structure.diagnosis import diagnose
from graphgs.structure.given import map_given
from graphgs.structure.grouping import grouping_of
from graphgs.structure.ladder import Candidate, climb, judged
from graphgs.structure.lens_by_gps import reopened
from graphgs.structure.matching import Matches
from graphgs.structure.model_calls import ModelCalls
from graphgs.structure.prior import Prior
from graphgs.structure.result import Structure, edges_among
from graphgs.structure.rig_refinement import constrained, rig_poses
from graphgs.structure.rigs import RigPose
from graphgs.structure.world import WorldFrame, plain, settled


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
    could be reconstructed, or the camera did not move."""
    if prior.source == "given":
        return map_given(config, photos, matches, prior, scratch=scratch, reporter=reporter, threads=threads, seed=seed)
    with ColmapWorker(scratch) as worker:
        calls = ModelCalls(config, photos, matches, prior, worker, scratch, reporter, threads, seed)
        if calls.witness.rotation.on_the_spot:
            raise DataError(
                calls.witness.rotation.describe(),
                hint="take a step between photos, and some from the side, each overlapping the next by half or more",
            )
        best, gps = climb(calls, prior.reconstruction), None
        if best is not None:
            best, gps = reopened(best)
        if best is not None and photos.rigs and config.rig_refinement == "constrained":
            best = _mounted(best)
        reporter.event("worker", stage="mapping", peak_rss_mb=round(worker.peak_rss_mb))
    if best is None:
        raise DataError(
            f"the matches of {len(matches.component)} connected photos gave no reconstruction",
            hint="photos must be taken from different places (not turned on the spot) and overlap by half or more",
        )
    matches = best.calls.matches  # the ladder may have matched more pairs
    reconstruction, rigs, world = _settled(config, best, photos, prior, reporter)
    reconstruction = colored(reconstruction, photos, threads=threads)
    edges, inliers = edges_among(matches, reconstruction.names)
    judgement = (best.soundness, best.support)
    grouping = grouping_of(config, matches, prior, reconstruction)
    diagnosis = diagnose(photos, matches, grouping, reconstruction, best.calls.witness, judgement, threads=threads)
    return Structure(
        reconstruction=reconstruction,
        edges=edges,
        inliers=inliers,
        accepted=best.accepted,
        method=best.method,
        agreement=best.agreement,
        compared_with=best.compared_with,
        grouping=grouping,
        unregistered=tuple((entry.name, entry.reason) for entry in diagnosis.left_out),
        rigs=rigs,
        world=world,
        diagnosis=diagnosis,
        cautions=(
            *_cautions(best, reconstruction, world),
            *(() if gps is None else gps.describe()),
            *diagnosis.cautions(matches),
        ),
        calibration=best.calls.calibration,
        upheld=best.upheld,
    )


def _mounted(best: Candidate) -> Candidate:
    """The candidate with its rigs rigid, if that is no worse."""
    model = constrained(best.calls, best.name, best.reconstruction, best.calls.reporter)
    if model is None:
        return best
    found = judged(best.calls, model, best.name, f"{best.method}, rig constrained", best.other, best.compared_with)
    return dataclasses.replace(found, free=best.reconstruction) if found.rank >= best.rank else best


def _cautions(best: Candidate, settled: Reconstruction, world: WorldFrame | None) -> tuple[str, ...]:
    """What the photos leave open, in the units of the final world."""
    weak = tuple(place.describe() for place in best.places if place.is_open)
    calibration = best.calls.calibration
    if calibration is None:
        return weak
    scale = diameter(settled.centers) / max(diameter(best.reconstruction.centers), 1e-12)
    return calibration.cautions("" if world is None else "m", scale) + weak


def _settled(
    config: StructureConfig, best: Candidate, photos: Photos, prior: Prior, reporter: Reporter
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
