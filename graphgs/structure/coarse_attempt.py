"""One attempt at a coarse reconstruction: few features, bounded pairs, a vote on the focal length, loose mapping."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.sources.rigs import Rig
from graphgs.structure.calibration.starts import wide_open
from graphgs.structure.cameras import SharedCameras, rescaled, shared_cameras
from graphgs.structure.coarse_lens import with_lens, with_two_lenses
from graphgs.structure.coarse_mapping import ABOUT_AS_MANY, CoarseMapper, Mapped
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.config import StructureConfig
from graphgs.structure.contradictions import support_of
from graphgs.structure.crashes import match_around_crashes
from graphgs.structure.database import create_database
from graphgs.structure.evidence import VerifiedMatches, read_verified
from graphgs.structure.feature_cache import FeatureCache
from graphgs.structure.features import extract_features, load_descriptors
from graphgs.structure.focal_vote import vote_of_pairs
from graphgs.structure.learned import learned_features, learned_matches
from graphgs.structure.retrieval import similar_photos
from graphgs.structure.rigs import same_frame_pairs, sequences
from graphgs.structure.soundness import LARGEST_STRENGTH

_VERIFICATION = {"min_num_inliers": 12}  # looser than COLMAP's default: features are few
_RETRIEVAL_DEPTH = 20  # look-alikes kept per photo, for bridges later
_OTHER_GUESSES = (0.72, 1.39)  # of the typical focal length, where the photos leave it open: 19 and 36 mm equivalent
_FURTHER_SEEDS = (100, 200)  # offsets, tried where a mapping is contradicted


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
    features: np.ndarray  # [N] per photo
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
    descriptors, offsets = load_descriptors(photos, features)
    similar = similar_photos(descriptors, offsets, words=config.retrieval_words, neighbors=_RETRIEVAL_DEPTH, seed=0)
    cameras = shared_cameras(photos)
    create_database(worker, database, photos, cameras, features)
    pairs = coarse_pairs(similar[:, : config.retrieval_neighbors], n, config.sequence_window, photos.rigs)
    verification = {**_VERIFICATION, "ransac": {"random_seed": 0}}
    if attempt.learned:
        learned_matches(photos, features, pairs.tolist(), work / "matches", threads=threads, reporter=reporter)
        worker.run("verify_given", database=database, matches=work / "matches", verification=verification)
    else:
        match_around_crashes(
            worker,
            photos.names,
            pairs.tolist(),
            work / "crashes.json",
            progress=lambda done, total: reporter.progress(done, total, "coarse matches"),
            database=database,
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
    mapper = CoarseMapper(photos, worker, work, reporter, threads)
    found, refine, lenses = mapper.best(guesses, attempt.seed, hold=hold), wide_open(cameras), ""
    if found is not None:
        found = _less_contradicted(mapper, found, guesses, attempt.seed, hold=hold)
        found, lenses = with_two_lenses(mapper, found, attempt.seed)
        if lenses:
            refine = ("focal", "k1")
        elif not vote.decided:
            found, refine = with_lens(mapper, found, attempt.seed)
    placed = 0 if found is None else len(found.model.names)
    reporter.event("coarse_attempt", **dataclasses.asdict(attempt), pairs=len(pairs), edges=len(edges), placed=placed)
    by = " by learned matches" if attempt.learned else ""
    note = f"own reconstruction at {attempt.max_side} px{by} places {placed} of {n} photos{lenses}"
    if found is None:
        return Found(None, cameras, refine, similar, np.diff(offsets), edges, note)
    return Found(found.model, found.cameras, refine, similar, np.diff(offsets), edges, note)


def _less_contradicted(
    mapper: CoarseMapper, found: Mapped, guesses: list[SharedCameras], seed: int, *, hold: bool
) -> Mapped:
    """Where its own matches contradict the mapping that was found (`contradictions`), it broke or folded: then other
    seeds are tried, and the mapping that is contradicted least is taken."""
    verified = read_verified(mapper.database)
    best, least = found, _contradiction(found.model, mapper.photos, verified)
    for offset in _FURTHER_SEEDS:
        if least < LARGEST_STRENGTH:
            break
        other = mapper.best(guesses, seed + offset, hold=hold)
        if other is None or len(other.model.names) < ABOUT_AS_MANY * len(best.model.names):
            continue
        strength = _contradiction(other.model, mapper.photos, verified)
        mapper.reporter.event("coarse_again", seed=seed + offset, contradiction=strength, before=least)
        if strength < least:
            best, least = other, strength
    return best


def _contradiction(model: Reconstruction, photos: Photos, verified: VerifiedMatches) -> float:
    """The largest strength of a pair that contradicts the model."""
    support = support_of(model, photos.names, verified)
    return float(support.objections(_VERIFICATION["min_num_inliers"]).max(initial=0.0))


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
