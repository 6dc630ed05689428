"""A quick reconstruction at low resolution: where every photo was taken, roughly, in seconds.

A small true reconstruction serves better as a prior than pairwise learned poses: it is already global (SIFT, sequence
and look-alike pairs, incremental mapping with loose thresholds). When it places too few photos it tries again with
another seed, then with more pixels and features.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.config import StructureConfig
from graphgs.structure.database import build_features, by_photo_names, shared_cameras
from graphgs.structure.prior import Prior, prior_from_reconstruction
from graphgs.structure.retrieval import similar_photos

# Looser than COLMAP's defaults: features are few, and a wrong photo here costs pairs only.
_VERIFICATION = {"min_num_inliers": 12}
_MAPPING = {
    "min_num_matches": 12,
    "min_model_size": 3,
    "max_num_models": 10,
    "ba_global_frames_ratio": 1.3,
    "ba_global_points_ratio": 1.3,
    "ba_global_max_refinements": 2,
    "ba_local_max_refinements": 1,
    "mapper": {
        "init_min_num_inliers": 50,
        "init_min_tri_angle": 8.0,
        "abs_pose_min_num_inliers": 15,
        "abs_pose_min_inlier_ratio": 0.15,
    },
}
_RETRIEVAL_DEPTH = 20  # look-alikes kept per photo, for bridges later
_ANOTHER_SEED = 1000  # offset


@dataclass(frozen=True)
class _Attempt:
    max_side: int
    features: int
    seed: int


def coarse_poses(
    config: StructureConfig,
    photos,
    *,
    scratch: Path,
    reporter: Reporter,
    threads: int,
    seed: int,
) -> Prior:
    """Our own coarse reconstruction of the photos. Raises DataError when not even three photos fit together."""
    attempts = (
        _Attempt(config.coarse_max_side, config.coarse_features, seed),
        _Attempt(config.coarse_max_side, config.coarse_features, seed + _ANOTHER_SEED),
        _Attempt(config.coarse_retry_max_side, config.coarse_retry_features, seed),
    )
    best: Reconstruction | None = None
    similar = np.zeros((len(photos.photos), 0), np.int64)
    best_attempt = attempts[0]
    with ColmapWorker(scratch) as worker:
        for attempt in attempts:
            found, similar, edges = _reconstruct(config, photos, attempt, worker, scratch, reporter, threads)
            if found is not None and (best is None or len(found.names) > len(best.names)):
                best, best_attempt = found, attempt
            if best is not None and len(best.names) >= config.min_registered * len(photos.photos):
                break
        reporter.event("worker", stage="coarse", peak_rss_mb=round(worker.peak_rss_mb))
    if best is None or len(best.names) < 3:
        raise _hopeless(photos, edges)
    note = (
        f"own reconstruction at {best_attempt.max_side} px, {best_attempt.features} features: "
        f"{len(best.names)} of {len(photos.photos)} photos placed"
    )
    reporter.info(f"coarse poses: {note}")
    return prior_from_reconstruction(photos.names, best, source="auto", note=note, own=True, similar=similar)


def _reconstruct(
    config: StructureConfig,
    photos,
    attempt: _Attempt,
    worker: ColmapWorker,
    scratch: Path,
    reporter: Reporter,
    threads: int,
) -> tuple[Reconstruction | None, np.ndarray, np.ndarray]:
    """(reconstruction or None, look-alikes [N, k], verified edges [E, 2]) of one attempt; continues what a kill left."""
    n = len(photos.photos)
    work = scratch / f"{attempt.max_side}_{attempt.features}"
    work.mkdir(parents=True, exist_ok=True)
    database = work / "database.db"
    build_features(
        worker,
        database,
        photos,
        shared_cameras(photos),
        max_side=attempt.max_side,
        max_features=attempt.features,
        first_octave=0,
        scratch=scratch,
        threads=threads,
        progress=lambda done, total: reporter.progress(done, total, "coarse features"),
    )
    worker.run("descriptors", database=database, out=work / "descriptors.npz")
    with np.load(work / "descriptors.npz", allow_pickle=False) as arrays:
        similar = similar_photos(
            arrays["data"], arrays["offsets"], words=config.retrieval_words, neighbors=_RETRIEVAL_DEPTH, seed=0
        )
    pairs = coarse_pairs(similar[:, : config.retrieval_neighbors], n, config.sequence_window)
    worker.run(
        "match",
        progress=lambda done, total: reporter.progress(done, total, "coarse matches"),
        database=database,
        pairs=pairs.tolist(),
        chunk_pairs=8 * config.chunk_pairs,
        matching={},
        verification={**_VERIFICATION, "ransac": {"random_seed": 0}},
        threads=threads,
        scratch=work,
    )
    worker.run("verified", database=database, out=work / "verified.npz")
    with np.load(work / "verified.npz", allow_pickle=False) as arrays:
        edges = arrays["edges"]
    reporter.event("coarse_matches", pairs=len(pairs), verified=len(edges))
    model = work / f"model_{attempt.seed}"
    if not model.exists():
        worker.run(
            "map_incrementally",
            progress=lambda done, total: reporter.progress(done, total, "coarse mapping"),
            database=database,
            root=photos.folder,
            out=model,
            start=None,
            options=_MAPPING,
            seed=attempt.seed,
            threads=threads,
        )
    found = by_photo_names(Reconstruction.load(model), photos) if model.exists() else None
    placed = 0 if found is None else len(found.names)
    reporter.event("coarse_attempt", max_side=attempt.max_side, seed=attempt.seed, placed=placed, photos=n)
    return found, similar, edges


def coarse_pairs(
    similar: np.ndarray,  # [N, k] look-alikes, -1 = none
    n: int,
    window: int,
) -> np.ndarray:
    """[P, 2] i < j, sorted: `window` neighbours in file order, then every power of two, and the look-alikes."""
    offsets = list(range(1, window + 1))
    step = 1
    while step < n:
        offsets.append(step)
        step *= 2
    i = np.arange(n)
    parts = [np.stack([i[: n - d], i[d:]], axis=1) for d in sorted(set(offsets)) if d < n]
    rows, ranks = np.nonzero(similar >= 0)
    parts.append(np.sort(np.stack([rows, similar[rows, ranks]], axis=1), axis=1))
    return np.unique(np.concatenate(parts), axis=0)


def _hopeless(photos, edges: np.ndarray) -> DataError:
    n = len(photos.photos)
    if len(edges) == 0:
        return DataError(
            f"no two of the {n} photos show the same scene: no pair has enough matching features",
            hint="take photos that overlap by half or more, sharp and with some texture in them",
        )
    return DataError(
        f"{len(edges)} pairs of the {n} photos match, but no three photos could be placed together",
        hint="photos must be taken from different places (not copies, not turned on the spot) and overlap by half or more",
    )
