"""Priors from elsewhere than a coarse reconstruction: file order, GPS, a pose file, poses that came with the input.

All but the last only choose pairs. They keep our own coarse reconstruction, where there is one, for the final poses to
start from and be compared with; so a wrong prior cannot bend the result.
"""

import dataclasses
import hashlib
from pathlib import Path

import numpy as np

from graphgs.errors import DataError, UsageError
from graphgs.progress import Reporter
from graphgs.sources.photos import Photos
from graphgs.sources.poses import read_poses
from graphgs.sources.positions import read_positions
from graphgs.structure.cameras import SharedCameras, shared_cameras
from graphgs.structure.coarse import coarse_poses
from graphgs.structure.coarse_attempt import coarse_pairs
from graphgs.structure.config import StructureConfig
from graphgs.structure.feature_cache import FeatureCache
from graphgs.structure.gps import enu_from_wgs84, median_position
from graphgs.structure.prior import Prior, poses_by_name
from graphgs.structure.relative_poses import global_poses, load_estimate

_FEWEST_GPS = 3
_KNOWN = "auto, learned, learned=FILE.py:FUNCTION, sequence, gps, gps=FILE or poses=FILE"


def make_prior(
    config: StructureConfig,
    photos: Photos,
    *,
    wanted: str,  # auto | learned | learned=FILE.py:FUNCTION | sequence | gps | gps=FILE | poses=FILE
    scratch: Path,
    reporter: Reporter,
    threads: int,
    seed: int,
    cache: FeatureCache | None = None,
) -> Prior:
    """The prior stage. Poses that came with the input come first: kept or refined they stand for everything else, as
    `config.poses` = prior they choose pairs in place of `auto`. Raises UsageError for a prior that is not known."""
    if photos.given is not None and config.poses != "prior":
        return given_prior(photos)
    run = {"scratch": scratch, "reporter": reporter, "threads": threads, "seed": seed, "cache": cache}
    kind, _, file = wanted.partition("=")
    if not _is_known(wanted):
        raise UsageError(f"--prior {wanted}: not known", hint=f"use {_KNOWN}")
    if kind == "auto" and photos.given is None:
        return coarse_poses(config, photos, **run)
    if wanted == "learned":
        return coarse_poses(config, photos, **run, learned=True)
    if kind == "learned":
        return model_prior(own_prior(config, photos, **run), config, photos, file)
    if kind == "sequence":
        return sequence_prior(own_prior(config, photos, **run))
    if kind == "gps":
        positions = read_positions(Path(file), photos.names) if file else exif_positions(photos)
        check_enough(positions, photos, file)
        return gps_prior(own_prior(config, photos, **run), positions, note=file or "EXIF GPS")
    if kind == "poses":
        names, rotations, centers = read_poses(Path(file), photos)
        return poses_prior(own_prior(config, photos, **run), names, rotations, centers, note=f"poses of {file}")
    given = photos.given
    own = own_prior(config, photos, **run)
    return poses_prior(own, given.names, given.rotations, given.centers, note="poses that came with the input")


def prior_fingerprint(wanted: str) -> str:
    """SHA-256 over the contents of the file that a prior is read from; "" without one."""
    kind, _, name = wanted.partition("=")
    file = Path(name.rpartition(":")[0] if kind == "learned" else name)
    if "=" not in wanted or not file.exists():
        return ""  # a missing file is an error of the stage itself
    total = hashlib.sha256()
    for part in sorted(p for p in file.iterdir() if p.is_file()) if file.is_dir() else [file]:
        total.update(f"\0{part.name}\0".encode() + part.read_bytes())
    return total.hexdigest()


def own_prior(
    config: StructureConfig,
    photos: Photos,
    *,
    scratch: Path,
    reporter: Reporter,
    threads: int,
    seed: int,
    cache: FeatureCache | None = None,
) -> Prior:
    """The coarse reconstruction, or nothing placed where it fails: enough below a prior from elsewhere."""
    try:
        return coarse_poses(config, photos, scratch=scratch, reporter=reporter, threads=threads, seed=seed, cache=cache)
    except DataError as error:
        reporter.warn(f"no coarse reconstruction to compare with: {error.message}")
    n = len(photos.photos)
    return Prior(
        names=photos.names,
        placed=np.zeros(n, dtype=bool),
        rotations=np.tile(np.eye(3), (n, 1, 1)),
        centers=np.full((n, 3), np.nan),
        cameras=shared_cameras(photos),
        refine=(),
        source="auto",
        note="no coarse reconstruction",
    )


def sequence_prior(own: Prior) -> Prior:
    """File order only: as if the photos lay evenly on a line."""
    n = len(own.names)
    centers = np.zeros((n, 3))
    centers[:, 0] = np.arange(n)
    return _guided(own, np.ones(n, dtype=bool), None, centers, "sequence", "file order")


def exif_positions(photos: Photos) -> dict[str, tuple[float, float, float]]:
    """Latitude, longitude [deg] and altitude [m] by photo name, of the photos that carry them."""
    return {photo.name: photo.gps for photo in photos.photos if photo.gps is not None}


def check_enough(positions: dict[str, tuple[float, float, float]], photos: Photos, file: str = "") -> None:
    """Raises DataError where GPS could guide nothing, before the work of a coarse reconstruction."""
    if len(positions) < _FEWEST_GPS:
        where = f"in {file}" if file else "in EXIF"
        raise DataError(
            f"only {len(positions)} of {len(photos.photos)} photos have a GPS position {where}",
            hint="use --prior auto, which needs none",
        )


def gps_prior(own: Prior, positions: dict[str, tuple[float, float, float]], *, note: str) -> Prior:
    """Positions in local east, north, up [m]; the final world gets this frame. Without orientations: a phone's GPS is
    too coarse to turn the coarse reconstruction into its frame, so pairs are not filtered."""
    placed = np.array([name in positions for name in own.names], dtype=bool)
    known = np.array([positions[name] for name in own.names if name in positions])
    centers = np.full((len(placed), 3), np.nan)
    centers[placed] = enu_from_wgs84(known)
    guided = _guided(own, placed, None, centers, "gps", f"{note} of {placed.sum()} of {len(placed)} photos")
    return dataclasses.replace(guided, origin=tuple(float(v) for v in median_position(known)))


def poses_prior(
    own: Prior,
    names: tuple[str, ...],  # [M] photos with a pose
    rotations: np.ndarray,  # [M, 3, 3] camera-from-world
    centers: np.ndarray,  # [M, 3] world
    *,
    note: str,
) -> Prior:
    """Poses from a file, to choose pairs."""
    row = {name: k for k, name in enumerate(names)}
    placed = np.array([name in row for name in own.names], dtype=bool)
    rows = np.array([row[name] for name in own.names if name in row], dtype=np.int64)
    all_rotations = np.tile(np.eye(3), (len(own.names), 1, 1))
    all_centers = np.full((len(own.names), 3), np.nan)
    all_rotations[placed], all_centers[placed] = rotations[rows], centers[rows]
    return _guided(own, placed, all_rotations, all_centers, "poses", note)


def model_prior(own: Prior, config: StructureConfig, photos: Photos, wanted: str) -> Prior:
    """Poses by the pairwise model of the user's "FILE.py:FUNCTION" (`relative_poses`), to choose pairs."""
    estimate = load_estimate(wanted)
    pairs = coarse_pairs(
        own.similar[:, : config.retrieval_neighbors], len(own.names), config.sequence_window, photos.rigs
    )
    relative = estimate([photos.folder / photo.pixels for photo in photos.photos], pairs)
    try:
        placed, rotations, centers = global_poses(relative, len(own.names))
    except ValueError as error:
        raise DataError(f"{wanted}: {error}", hint="graphgs.structure.relative_poses says what is expected") from None
    note = f"relative poses by {wanted} place {placed.sum()} of {len(placed)} photos"
    return _guided(own, placed, rotations, centers, "learned", note)


def given_prior(photos: Photos) -> Prior:
    """The poses and intrinsics that came with the input, to be kept or refined. Photos without one stay out."""
    given = photos.given
    placed, rotations, centers = poses_by_name(photos.names, given)
    return Prior(
        names=photos.names,
        placed=placed,
        rotations=rotations,
        centers=centers,
        cameras=_given_cameras(photos),
        refine=(),
        source="given",
        note=f"poses of {placed.sum()} of {len(placed)} photos came with the input",
        reconstruction=given,
    )


def _is_known(wanted: str) -> bool:
    kind, equals, file = wanted.partition("=")
    if wanted in ("auto", "learned", "sequence", "gps"):
        return True
    return kind in ("gps", "learned", "poses") and bool(equals and file)


def _given_cameras(photos: Photos) -> SharedCameras:
    """The given cameras, and our own guess for photos that have none."""
    given, guess = photos.given, shared_cameras(photos)
    row = {name: k for k, name in enumerate(given.names)}
    ids = [
        given.camera_ids[row[name]] if name in row else len(given.cameras) + camera
        for name, camera in zip(photos.names, guess.camera_ids, strict=True)
    ]
    known = (True,) * len(given.cameras) + guess.known
    return SharedCameras(given.cameras + guess.cameras, known, np.array(ids, dtype=np.int64))


def _guided(
    own: Prior, placed: np.ndarray, rotations: np.ndarray | None, centers: np.ndarray, source: str, note: str
) -> Prior:
    return dataclasses.replace(
        own,
        placed=placed,
        rotations=np.tile(np.eye(3), (len(placed), 1, 1)) if rotations is None else rotations,
        centers=centers,
        source=source,
        note=f"{note}; {own.note}",
        oriented=rotations is not None,
    )
