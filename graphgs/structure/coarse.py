"""A quick reconstruction at low resolution: where every photo was taken, roughly, in seconds.

A small true reconstruction serves better as a prior than pairwise learned poses: it is already global. When it places
too few photos it is tried again with another seed and intrinsics held, then with more pixels and features, and then,
where they are installed, with learned matches.
"""

import dataclasses
from pathlib import Path

import numpy as np

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.sources.photos import Photos
from graphgs.structure.calibration.lens import opened
from graphgs.structure.cameras import with_cameras, with_lenses
from graphgs.structure.coarse_attempt import Attempt, Found, run_attempt
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.config import StructureConfig
from graphgs.structure.feature_cache import FeatureCache
from graphgs.structure.learned import check_installed, is_installed
from graphgs.structure.nothing_matches import fault_of_photos
from graphgs.structure.prior import Prior, poses_by_name

_ANOTHER_SEED = 1000  # offset


def coarse_poses(
    config: StructureConfig,
    photos: Photos,
    *,
    scratch: Path,
    reporter: Reporter,
    threads: int,
    seed: int,
    cache: FeatureCache | None = None,
    learned: bool = False,
) -> Prior:
    """Our own coarse reconstruction of the photos. Learned matches come into it where SIFT places too few photos and
    their package is installed, or at once with `learned`.

    Raises DataError when not even three photos fit together, UsageError for `learned` without its package."""
    by_learning = Attempt(config.learned_max_side, config.learned_features, seed, False, learned=True)
    if learned:
        check_installed()
    attempts = (
        Attempt(config.coarse_max_side, config.coarse_features, seed, False),
        Attempt(config.coarse_max_side, config.coarse_features, seed + _ANOTHER_SEED, True),
        Attempt(config.coarse_retry_max_side, config.coarse_retry_features, seed, False),
    )
    if learned:
        attempts = (by_learning, *attempts)
    elif is_installed():
        attempts = (*attempts, by_learning)
    best: Found | None = None
    with ColmapWorker(scratch) as worker:
        for attempt in attempts:
            found = run_attempt(config, photos, attempt, worker, scratch, reporter, threads, cache)
            if best is None or found.placed > best.placed:
                best = found
            if best.placed >= config.min_registered * len(photos.photos):
                break
        reporter.event("worker", stage="coarse", peak_rss_mb=round(worker.peak_rss_mb))
    if best.placed < 3:
        raise fault_of_photos(photos, best.features, threads=threads) or _hopeless(photos, best.edges)
    reporter.info(f"coarse poses: {best.note}")
    cameras = with_lenses(best.cameras, photos, best.reconstruction, best.reconstruction.cameras)
    cameras = dataclasses.replace(cameras, cameras=tuple(opened(c, best.refine) for c in cameras.cameras))
    reconstruction = with_cameras(best.reconstruction, cameras, photos.names)
    placed, rotations, centers = poses_by_name(photos.names, reconstruction)
    return Prior(
        names=photos.names,
        placed=placed,
        rotations=rotations,
        centers=centers,
        cameras=cameras,
        refine=best.refine,
        source="auto",
        note=best.note,
        reconstruction=reconstruction,
        similar=best.similar,
    )


def _hopeless(photos: Photos, edges: np.ndarray) -> DataError:
    n = len(photos.photos)
    if len(edges) == 0:
        return DataError(
            f"no two of the {n} photos show the same scene: no pair has enough matching features",
            hint="take photos that overlap by half or more, sharp and with some texture in them",
        )
    return DataError(
        f"{len(edges)} pairs of the {n} photos match, but no three photos could be placed together",
        hint="photos must be taken from different places (no copies, not turned on the spot) and overlap by half",
    )
