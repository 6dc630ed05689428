"""Structure from poses that came with the input: kept as they are, or refined."""

import dataclasses
from pathlib import Path

import numpy as np
from scipy import sparse

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.scene.covisibility import shared_points
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.structure.acceptance import agreement
from graphgs.structure.calibration.starts import wide_open
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.colors import colored
from graphgs.structure.config import StructureConfig
from graphgs.structure.diagnosis import diagnose
from graphgs.structure.focal_vote import vote_of_pairs
from graphgs.structure.grouping import Grouping, grouping_of
from graphgs.structure.matching import Matches
from graphgs.structure.model_calls import ModelCalls
from graphgs.structure.prior import Prior
from graphgs.structure.result import Structure, edges_among
from graphgs.structure.rig_refinement import rig_poses


def needs_matching(config: StructureConfig, photos: Photos) -> bool:
    """Whether given poses need our own matches: to be refined, or because they came without points."""
    return config.poses != "keep" or photos.given is None or len(photos.given.points) == 0


def keep_given(config: StructureConfig, photos: Photos, cautions: tuple[str, ...] = ()) -> Structure:
    """The poses and points of the input, untouched. Edges are pairs that see `config.min_inliers` points together.
    `cautions` are what holding them against the photos left to be said."""
    given = photos.given
    edges, shared = covisible_pairs(given, least=config.min_inliers)
    return Structure(
        reconstruction=given,
        edges=edges,
        inliers=shared,
        accepted=True,
        method="poses and points of the input, kept",
        agreement=None,
        compared_with="",
        grouping=Grouping.one(given.names),
        unregistered=_without_pose(photos),
        rigs=rig_poses(photos, given),
        cautions=cautions,
        origin=photos.origin,
    )


def map_given(
    config: StructureConfig,
    photos: Photos,
    matches: Matches,
    prior: Prior,
    *,
    scratch: Path,
    reporter: Reporter,
    threads: int,
    seed: int,
    cautions: tuple[str, ...] = (),
) -> Structure:
    """Points for the given poses; with `config.poses` = refine also bundle adjustment, compared with what was given.

    Intrinsics are refined with the poses, unless the photos do not determine the focal length."""
    refine = config.poses == "refine"
    given = prior.reconstruction
    with ColmapWorker(scratch) as worker:
        if refine:
            vote = vote_of_pairs(worker, matches.database, scratch, prior.cameras)
            prior = dataclasses.replace(prior, refine=() if vote.flat else wide_open(prior.cameras))
        calls = ModelCalls(config, photos, matches, prior, worker, scratch, reporter, threads, seed)
        model = calls.triangulated(given, "refined") if refine else calls.triangulated_only(given, "triangulated")
        reporter.event("worker", stage="mapping", peak_rss_mb=round(worker.peak_rss_mb))
    if model is None or len(model.points) == 0:
        raise DataError(
            "no point could be triangulated from the poses that came with the input: they do not fit the photos",
            hint="check that the poses belong to these photos, or use --poses prior to find our own",
        )
    agreed = agreement(given, model) if refine else None
    if not refine:  # COLMAP holds rotations as quaternions: put back what was given, to the last bit
        model = dataclasses.replace(model, rotations=given.rotations, translations=given.translations)
    reconstruction = colored(model, photos, threads=threads)
    edges, inliers = edges_among(matches, reconstruction.names)
    judgement = calls.witness.judge(reconstruction)
    grouping = grouping_of(config, matches, prior, reconstruction, joined=True)
    diagnosis = diagnose(photos, matches, grouping, reconstruction, calls.witness, judgement, threads=threads)
    return Structure(
        reconstruction=reconstruction,
        edges=edges,
        inliers=inliers,
        accepted=agreed is None or agreed.within(config),
        method=_refined(prior) if refine else "poses of the input, kept; points triangulated",
        agreement=agreed,
        compared_with="the poses of the input" if refine else "",
        grouping=grouping,
        unregistered=tuple((entry.name, entry.reason) for entry in diagnosis.left_out)
        if refine
        else _without_pose(photos),
        rigs=rig_poses(photos, reconstruction),
        diagnosis=diagnosis,
        cautions=cautions + diagnosis.cautions(matches),
        origin=photos.origin,
    )


def _refined(prior: Prior) -> str:
    held = "; intrinsics kept, for the photos do not determine the focal length" if not prior.refine else ""
    return f"poses of the input, refined{held}"


def covisible_pairs(reconstruction: Reconstruction, *, least: int) -> tuple[np.ndarray, np.ndarray]:
    """(edges [E, 2] i < j sorted, shared points [E]) of the pairs that see at least `least` points together."""
    shared = sparse.triu(shared_points(reconstruction), k=1).tocoo()
    keep = shared.data >= least
    edges = np.stack([shared.row[keep], shared.col[keep]], axis=1).astype(np.int64)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    return edges[order], shared.data[keep][order]


def _without_pose(photos: Photos) -> tuple[tuple[str, str], ...]:
    has_pose = set(photos.given.names)
    return tuple((name, "the input gives no pose for it") for name in photos.names if name not in has_pose)
