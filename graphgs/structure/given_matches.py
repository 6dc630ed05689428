"""Matches of our own among photos with given poses, found without looking at the poses or the intrinsics."""

from pathlib import Path

import numpy as np

from graphgs.progress import Reporter
from graphgs.scene.names import as_counted
from graphgs.scene.neighbours import nearest
from graphgs.sources.photos import Photos
from graphgs.structure.cameras import SharedCameras
from graphgs.structure.coarse_attempt import coarse_pairs
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.config import StructureConfig
from graphgs.structure.crashes import match_around_crashes
from graphgs.structure.database import create_database
from graphgs.structure.evidence import VerifiedMatches, read_verified
from graphgs.structure.feature_cache import FeatureCache
from graphgs.structure.features import extract_features, load_descriptors
from graphgs.structure.retrieval import similar_photos

_NEAREST = 5  # by given pose
_VERIFICATION = {"min_num_inliers": 15, "ransac": {"random_seed": 0}}  # COLMAP's own limit: here a wrong pair counts


def independent_matches(
    config: StructureConfig,
    photos: Photos,
    *,
    scratch: Path,
    reporter: Reporter,
    threads: int,
    cache: FeatureCache | None = None,
) -> VerifiedMatches:
    """Verified matches among all the photos, which all have given poses. Pairs are neighbours by name, look-alikes, and
    neighbours by pose: right poses are tried where they should hold, and wrong ones do not choose what they are tried
    on. Verification believes no intrinsics, so it is the fundamental matrix that matches must share."""
    folder = scratch / "features"
    extract_features(
        photos,
        folder,
        max_side=config.coarse_max_side,
        max_features=config.coarse_features,
        first_octave=0,
        threads=threads,
        progress=lambda done, total: reporter.progress(done, total, "features"),
        cache=cache,
    )
    similar = similar_photos(
        *load_descriptors(photos, folder),
        words=config.retrieval_words,
        neighbors=config.retrieval_neighbors,
        seed=0,
    )
    given = photos.given
    cameras = SharedCameras(given.cameras, (False,) * len(given.cameras), given.camera_ids)
    database = scratch / "database.db"
    with ColmapWorker(scratch) as worker:
        create_database(worker, database, photos, cameras, folder)
        match_around_crashes(
            worker,
            photos.names,
            pairs_to_try(similar, photos.names, given.centers, config.sequence_window).tolist(),
            scratch / "crashes.json",
            progress=lambda done, total: reporter.progress(done, total, "matches"),
            database=database,
            chunk_pairs=8 * config.chunk_pairs,
            matching={},
            verification=_VERIFICATION,
            threads=threads,
            scratch=scratch,
        )
        worker.run("settle", database=database)
    return read_verified(database)


def pairs_to_try(
    similar: np.ndarray,  # [N, k] look-alikes, -1 = none
    names: tuple[str, ...],  # [N]
    centers: np.ndarray,  # [N, 3] of given poses
    window: int,  # neighbours by name, on each side
) -> np.ndarray:
    """[P, 2] int i < j, sorted."""
    n = len(names)
    nothing = np.zeros((0, 2), np.int64)
    by_number = as_counted(names)[coarse_pairs(np.zeros((n, 0), np.int64), n, window)] if n > 1 else nothing
    by_name = coarse_pairs(similar, n, window) if n > 1 else nothing
    near = nearest(centers, _NEAREST)[0]
    by_pose = np.stack([np.repeat(np.arange(n), near.shape[1]), near.ravel()], axis=1)
    return np.unique(np.sort(np.concatenate([by_number, by_name, by_pose]), axis=1), axis=0)
