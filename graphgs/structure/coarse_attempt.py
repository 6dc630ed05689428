"""One attempt at a coarse reconstruction: few features, bounded pairs, a vote on the focal length, loose mapping."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.sources.rigs import Rig
from graphgs.structure.calibration.lens import refinements, undistorted
from graphgs.structure.calibration.opening import self_calibrate
from graphgs.structure.calibration.starts import largest_move, lens_starts, wide_open
from graphgs.structure.calibration.trials import Trials
from graphgs.structure.cameras import SharedCameras, rescaled, shared_cameras, with_lenses
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.config import StructureConfig
from graphgs.structure.contradictions import support_of
from graphgs.structure.database import by_photo_names, create_database
from graphgs.structure.evidence import VerifiedMatches, read_verified
from graphgs.structure.feature_cache import FeatureCache
from graphgs.structure.features import extract_features, load_descriptors
from graphgs.structure.focal_vote import vote_of_pairs
from graphgs.structure.learned import learned_features, learned_matches
from graphgs.structure.retrieval import similar_photos
from graphgs.structure.rigs import same_frame_pairs, sequences
from graphgs.structure.soundness import LARGEST_STRENGTH

# Looser than COLMAP's defaults: features are few, and a wrong photo here costs pairs only.
_VERIFICATION = {"min_num_inliers": 12}
# Bundle adjustment that stops where it hardly gains: a third less time in all, poses as accurate (0027).
_QUICKLY_SOLVED = {
    "ba_global_function_tolerance": 1e-4,
    "ba_global_max_num_iterations": 20,
    "ba_local_function_tolerance": 1e-4,
    "ba_local_max_num_iterations": 15,
}
_MAPPING = {
    "min_num_matches": 12,
    "min_model_size": 3,
    "max_num_models": 10,
    "ba_global_frames_ratio": 1.3,
    "ba_global_points_ratio": 1.3,
    "ba_global_max_refinements": 2,
    "ba_local_max_refinements": 1,
    **_QUICKLY_SOLVED,
    "mapper": {
        "init_min_num_inliers": 50,
        "init_min_tri_angle": 8.0,
        "abs_pose_min_num_inliers": 15,
        "abs_pose_min_inlier_ratio": 0.15,
    },
}
_HELD = {
    **_MAPPING,
    "ba_refine_focal_length": False,
    "ba_refine_extra_params": False,
    "mapper": {
        **_MAPPING["mapper"],
        "abs_pose_refine_focal_length": False,
        "abs_pose_refine_extra_params": False,
    },
}
_RETRIEVAL_DEPTH = 20  # look-alikes kept per photo, for bridges later
_LARGEST_DRIFT = 1.6  # a focal length that mapping changed by more is a sign of a broken model
_OTHER_GUESSES = (0.72, 1.39)  # of the typical focal length, where the photos leave it open: 19 and 36 mm equivalent
_FURTHER_SEEDS = (100, 200)  # offsets, tried where a mapping is contradicted
_FAR_MOVE = 0.03  # of a focal length, or of the distortion at the corner: poses found with the other one are bent
_MOST_REMAPPINGS = 2
_STRAIGHTENING = {"max_error_px": 4.0, "min_angle_deg": 1.5, "loss": "CAUCHY", "loss_scale_px": 1.0, "tolerance": 1e-5}
_EXPLAINED_PX = 2.0  # an observation further off counts for nothing
_ABOUT_AS_MANY = 0.98  # of the photos that the best mapping places


@dataclass(frozen=True)
class Attempt:
    max_side: int
    features: int
    seed: int
    hold: bool  # keep the voted intrinsics, whatever the photos seem to say
    learned: bool = False  # XFeat and LighterGlue in place of SIFT


@dataclass(frozen=True)
class Found:
    """What an attempt brought."""

    reconstruction: Reconstruction | None
    cameras: SharedCameras
    refine: tuple[str, ...]  # parameters of the lenses that the photos determine
    similar: np.ndarray  # [N, k] look-alikes
    edges: np.ndarray  # [E, 2] verified
    note: str

    @property
    def placed(self) -> int:
        return 0 if self.reconstruction is None else len(self.reconstruction.names)


def run_attempt(
    config: StructureConfig,
    photos: Photos,
    attempt: Attempt,
    worker: ColmapWorker,
    scratch: Path,
    reporter: Reporter,
    threads: int,
    cache: FeatureCache | None = None,
) -> Found:
    """Features, pairs, matches, focal length and mapping; continues what a kill left."""
    n = len(photos.photos)
    work = scratch / f"{attempt.max_side}_{attempt.features}{'_learned' if attempt.learned else ''}"
    features, database = work / "features", work / "database.db"
    size = {"max_side": attempt.max_side, "max_features": attempt.features}
    if attempt.learned:
        learned_features(photos, features, **size, threads=threads, reporter=reporter)
    else:
        extract_features(
            photos,
            features,
            **size,
            first_octave=0,
            threads=threads,
            progress=lambda done, total: reporter.progress(done, total, "coarse features"),
            cache=cache,
        )
    similar = similar_photos(
        *load_descriptors(photos, features), words=config.retrieval_words, neighbors=_RETRIEVAL_DEPTH, seed=0
    )
    cameras = shared_cameras(photos)
    create_database(worker, database, photos, cameras, features)
    pairs = coarse_pairs(similar[:, : config.retrieval_neighbors], n, config.sequence_window, photos.rigs)
    verification = {**_VERIFICATION, "ransac": {"random_seed": 0}}
    if attempt.learned:
        learned_matches(photos, features, pairs.tolist(), work / "matches", threads=threads, reporter=reporter)
        worker.run("verify_given", database=database, matches=work / "matches", verification=verification)
    else:
        worker.run(
            "match",
            progress=lambda done, total: reporter.progress(done, total, "coarse matches"),
            database=database,
            pairs=pairs.tolist(),
            chunk_pairs=8 * config.chunk_pairs,
            matching={},
            verification=verification,
            threads=threads,
            scratch=work,
        )
    worker.run("verified", database=database, out=work / "verified.npz")
    with np.load(work / "verified.npz", allow_pickle=False) as arrays:
        edges = arrays["edges"]
    vote = vote_of_pairs(worker, database, work, cameras)
    hold = attempt.hold or vote.flat
    cameras = rescaled(cameras, vote.scale)
    reporter.event("focal", **dataclasses.asdict(vote))
    guesses = [cameras]
    if vote.flat and not all(shared_cameras(photos).known):
        guesses += [rescaled(shared_cameras(photos), scale) for scale in _OTHER_GUESSES]
    run = (worker, work, reporter, threads)
    found = _best_mapping(photos, guesses, attempt, hold, *run)
    refine = wide_open(cameras)
    if found is not None:
        found = _less_contradicted(photos, found, guesses, attempt, hold, *run)
        if not vote.decided:
            found, refine = _with_lens(photos, found, attempt, *run)
    placed = 0 if found is None else len(found.model.names)
    reporter.event("coarse_attempt", **dataclasses.asdict(attempt), pairs=len(pairs), edges=len(edges), placed=placed)
    by = " by learned matches" if attempt.learned else ""
    note = f"own reconstruction at {attempt.max_side} px{by} places {placed} of {n} photos"
    if found is None:
        return Found(None, cameras, refine, similar, edges, note)
    return Found(found.model, found.cameras, refine, similar, edges, note)


@dataclass(frozen=True)
class _Mapped:
    model: Reconstruction  # by photo names
    cameras: SharedCameras  # that mapping started from
    folder: Path  # of the same model, by pixel files


def _with_lens(
    photos: Photos,
    found: _Mapped,
    attempt: Attempt,
    worker: ColmapWorker,
    work: Path,
    reporter: Reporter,
    threads: int,
) -> tuple[_Mapped, tuple[str, ...]]:
    """The mapping with the lenses that its photos speak for, and what they determine of them. Where a focal length
    moved far, it is mapped anew: poses that were found with a wrong one are bent."""
    best, refine, most = found, (), -np.inf
    for turn in range(_MOST_REMAPPINGS + 1):
        trials = Trials(worker, found.folder, work / f"{found.folder.name}_lens", attempt.seed, threads)
        own = Reconstruction.load(found.folder)
        starts = lens_starts(photos, found.model, tuple(undistorted(camera) for camera in own.cameras))
        calibration, _ = self_calibrate(trials, own, starts, seed=attempt.seed)
        adjusted, _ = trials.run("adjusted", calibration.cameras, calibration.refine)
        folder = work / f"{found.folder.name}_straight"
        straight = _straightened(adjusted, calibration.refine, attempt, worker, work, folder, threads)
        moved, explained = largest_move(own.cameras, calibration.cameras), _explained(straight)
        reporter.event("coarse_lens", turn=turn, moved=moved, explained=explained, **calibration.record())
        model = by_photo_names(straight, photos)
        if explained > most:
            cameras = with_lenses(found.cameras, photos, model, model.cameras)
            best, refine, most = _Mapped(model, cameras, folder), calibration.refine, explained
        if moved <= _FAR_MOVE:
            break
        cameras = with_lenses(found.cameras, photos, model, model.cameras)
        other = _mapped(photos, cameras, attempt, f"turn{turn}", True, worker, work, reporter, threads)
        if other is None or len(other.model.names) < _ABOUT_AS_MANY * len(found.model.names):
            break
        found = other
    return best, refine


def _straightened(
    adjusted: Reconstruction,  # by pixel files
    refine: tuple[str, ...],
    attempt: Attempt,
    worker: ColmapWorker,
    work: Path,
    folder: Path,  # for the model
    threads: int,
) -> Reconstruction:
    """The matches triangulated anew from poses that another lens has moved: many did not fit before."""
    if not folder.exists():
        adjusted.save(work / f"{folder.name}_from")
        worker.run(
            "triangulate",
            database=work / "database.db",
            poses=work / f"{folder.name}_from",
            out=folder,
            rounds=[_STRAIGHTENING],
            refine=["poses", *refinements(refine)],
            seed=attempt.seed,
            threads=threads,
        )
    return Reconstruction.load(folder)


def _explained(model: Reconstruction) -> float:
    """What a model makes of its photos: every observation counts the more, the better it fits. A broken model explains
    less than a bent one that bundle adjustment straightened, though its errors may be as small."""
    errors = np.repeat(model.errors, model.track_lengths)
    return float(np.maximum(1.0 - (errors / _EXPLAINED_PX) ** 2, 0.0).sum())


def _less_contradicted(
    photos: Photos,
    found: _Mapped,
    guesses: list[SharedCameras],
    attempt: Attempt,
    hold: bool,
    worker: ColmapWorker,
    work: Path,
    reporter: Reporter,
    threads: int,
) -> _Mapped:
    """Where its own matches contradict the mapping that was found (`contradictions`), it broke or folded: then other
    seeds are tried, and the mapping that is contradicted least is taken."""
    verified = read_verified(work / "database.db")
    best, least = found, _contradiction(found.model, photos, verified)
    for offset in _FURTHER_SEEDS:
        if least < LARGEST_STRENGTH:
            break
        another = dataclasses.replace(attempt, seed=attempt.seed + offset)
        other = _best_mapping(photos, guesses, another, hold, worker, work, reporter, threads)
        if other is None or len(other.model.names) < _ABOUT_AS_MANY * len(best.model.names):
            continue
        strength = _contradiction(other.model, photos, verified)
        reporter.event("coarse_again", seed=another.seed, contradiction=strength, before=least)
        if strength < least:
            best, least = other, strength
    return best


def _contradiction(model: Reconstruction, photos: Photos, verified: VerifiedMatches) -> float:
    """The largest strength of a pair that contradicts the model."""
    support = support_of(model, photos.names, verified)
    return float(support.objections(_VERIFICATION["min_num_inliers"]).max(initial=0.0))


def _best_mapping(
    photos: Photos,
    guesses: list[SharedCameras],  # intrinsics to start from
    attempt: Attempt,
    hold: bool,
    worker: ColmapWorker,
    work: Path,
    reporter: Reporter,
    threads: int,
) -> _Mapped | None:
    """The mapping that places the most photos, and among those that place about as many the one with the least error:
    far off the true focal length a turn of the road bends wrongly, and the error grows by a quarter."""
    results = []
    for k, cameras in enumerate(guesses):
        found = _mapped(photos, cameras, attempt, str(k), hold, worker, work, reporter, threads)
        if found is not None:
            results.append(found)
    if not results:
        return None
    most = max(len(found.model.names) for found in results)
    even = [found for found in results if len(found.model.names) >= _ABOUT_AS_MANY * most]
    return min(even, key=lambda found: _mean_error(found.model))


def _mapped(
    photos: Photos,
    cameras: SharedCameras,  # intrinsics to start from
    attempt: Attempt,
    label: str,
    hold: bool,
    worker: ColmapWorker,
    work: Path,
    reporter: Reporter,
    threads: int,
) -> _Mapped | None:
    """A mapping from nothing; None where there is none, or where it drifted away from the focal lengths it started
    from."""
    model = work / f"model_{attempt.seed}_{label}{'_held' if hold else ''}"
    if not model.exists():
        worker.run("set_cameras", database=work / "database.db", cameras=cameras.records())
        worker.run(
            "map_incrementally",
            progress=lambda done, total: reporter.progress(done, total, "coarse mapping"),
            database=work / "database.db",
            out=model,
            start=None,
            options=_HELD if hold else _MAPPING,
            seed=attempt.seed,
            threads=threads,
        )
    if not model.exists():
        return None
    found = by_photo_names(Reconstruction.load(model), photos)
    drift = _drift(found, cameras, photos)
    reporter.event("coarse_mapping", name=label, placed=len(found.names), error_px=_mean_error(found), drift=drift)
    return _Mapped(found, cameras, model) if drift <= _LARGEST_DRIFT else None


def _mean_error(model: Reconstruction) -> float:
    """[px]"""
    return float(model.errors.mean()) if len(model.errors) else np.inf


def _drift(found: Reconstruction, start: SharedCameras, photos: Photos) -> float:
    """The largest factor by which mapping changed a focal length."""
    row = {name: k for k, name in enumerate(photos.names)}
    before = np.array([start.cameras[start.camera_ids[row[name]]].params[0] for name in found.names])
    after = np.array([found.camera_of(k).params[0] for k in range(len(found.names))])
    return float(np.exp(np.abs(np.log(np.maximum(after, 1e-6) / before)).max()))


def coarse_pairs(
    similar: np.ndarray,  # [N, k] look-alikes, -1 = none
    n: int,
    window: int,
    rigs: tuple[Rig, ...] = (),
) -> np.ndarray:
    """[P, 2] i < j, sorted: `window` neighbours in file order, then every power of two, and the look-alikes. Each
    camera of a rig has a file order of its own, and is paired with the others frame by frame."""
    offsets = list(range(1, window + 1))
    step = 1
    while step < n:
        offsets.append(step)
        step *= 2
    parts = [
        np.stack([row[:-d], row[d:]], axis=1)
        for row in sequences(n, rigs)
        for d in sorted(set(offsets))
        if d < len(row)
    ]
    rows, ranks = np.nonzero(similar >= 0)
    parts += [np.stack([rows, similar[rows, ranks]], axis=1), same_frame_pairs(rigs)]
    return np.unique(np.sort(np.concatenate(parts), axis=1), axis=0)
