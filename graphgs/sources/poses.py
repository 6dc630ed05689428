"""Camera poses from files: those an INPUT carries, and those a user offers as a prior."""

from pathlib import Path

import numpy as np

from graphgs.errors import DataError, UsageError
from graphgs.scene.camera import Camera
from graphgs.scene.colmap import read_model
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.config import SourcesConfig
from graphgs.sources.decode import UnusableError, read_header
from graphgs.sources.given import fit_to_photos, match_names
from graphgs.sources.given_mends import mended
from graphgs.sources.layout import Layout
from graphgs.sources.nuscenes import read_pose_json
from graphgs.sources.photos import Photos
from graphgs.sources.trajectory import KITTI_COLUMNS, kitti_poses, read_calibration, read_rows, tum_poses

TUM_TOLERANCE_S = 0.02  # between a photo's timestamp name and its pose, as TUM's own associate.py
LEAST = 3  # poses below this cannot guide anything


def given_poses(layout: Layout, config: SourcesConfig) -> Reconstruction | None:
    """The poses that come with the input, at the sizes their file states, read as the settings say. Raises DataError if
    it cannot be used."""
    if layout.kind == "colmap":
        poses = read_model(layout.poses)
    elif layout.transforms is not None:
        poses = layout.transforms.reconstruction(lambda name: _size_of(layout.root / name))
    elif layout.kind == "kitti":
        poses = _kitti(layout)
    else:
        return None
    return mended(poses, config, _format_axes(layout))


def axes_in_use(config: SourcesConfig, layout: Layout) -> str:
    """opencv or opengl: the camera axes that given poses are read with."""
    return _format_axes(layout) if config.given_axes == "auto" else config.given_axes


def _format_axes(layout: Layout) -> str:
    return "opencv" if layout.transforms is None else layout.transforms.axes


def read_poses(file: Path, photos: Photos) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """(names, rotations [N, 3, 3] camera-from-world, centers [N, 3]) of the photos a pose file knows.

    `file` is a COLMAP model folder, a transforms.json, a list in nuScenes' terms, a KITTI poses.txt or a TUM
    trajectory. Rows without names belong to the photos in order of name, or, in a TUM file, to photos named by their
    time in seconds.
    """
    if not file.exists():
        raise UsageError(f"{file}: does not exist", hint="--prior poses=FILE takes a COLMAP model, JSON, KITTI or TUM")
    if file.is_dir():
        found = fit_to_photos(read_model(file), photos.photos)
        names, rotations, centers = found.names, found.rotations, found.centers
    elif file.suffix.lower() == ".json":
        transforms = read_pose_json(file)
        sizes = {photo.name: (photo.original_width, photo.original_height) for photo in photos.photos}
        owner = {i: name for name, i in match_names(tuple(f.name for f in transforms.frames), photos.names).items()}
        size_by_frame = {transforms.frames[i].name: sizes[name] for i, name in owner.items()}
        found = fit_to_photos(transforms.reconstruction(size_by_frame.get), photos.photos)
        names, rotations, centers = found.names, found.rotations, found.centers
    else:
        names, rotations, centers = _rows(file, photos)
    if len(names) < LEAST:
        raise DataError(
            f"{file}: has poses for {len(names)} of the {len(photos.photos)} photos",
            hint="image names must be those of the photos; check that the file belongs to them",
        )
    return names, rotations, centers


def _rows(file: Path, photos: Photos) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    rows = read_rows(file)
    if rows.shape[1] == KITTI_COLUMNS:
        rotations, centers = kitti_poses(rows)
    else:
        times, rotations, centers = tum_poses(rows)
        stamps = [_stamp(name) for name in photos.names]
        if all(stamp is not None for stamp in stamps):
            gaps = np.abs(np.array(stamps)[:, None] - times)
            if (gaps.min(axis=1) <= TUM_TOLERANCE_S).any():
                nearest, near = gaps.argmin(axis=1), gaps.min(axis=1) <= TUM_TOLERANCE_S
                names = tuple(name for name, ok in zip(photos.names, near, strict=True) if ok)
                return names, rotations[nearest[near]], centers[nearest[near]]
    everything = sorted({*photos.names, *(skipped.name for skipped in photos.skipped)})
    if len(rows) == len(everything):
        order = {name: i for i, name in enumerate(everything)}
    elif len(rows) == len(photos.names):
        order = {name: i for i, name in enumerate(photos.names)}
    else:
        raise DataError(
            f"{file}: {len(rows)} poses for {len(photos.names)} photos; rows without names need one per photo",
            hint="give the poses as transforms.json or a COLMAP model, which name the photos",
        )
    index = np.array([order[name] for name in photos.names], dtype=np.int64)
    return photos.names, rotations[index], centers[index]


def _stamp(name: str) -> float | None:
    """[s] the time a photo is named by, as in TUM's 1305031102.175304.png."""
    try:
        return float(name.rpartition("/")[2].rpartition(".")[0])
    except ValueError:
        return None


def _kitti(layout: Layout) -> Reconstruction:
    rows = read_rows(layout.poses)
    if len(rows) != len(layout.names):
        raise DataError(
            f"{layout.poses}: {len(rows)} poses for {len(layout.names)} photos in {layout.root}",
            hint="a KITTI poses.txt has one row per photo; if it is not theirs, give the folder of photos alone",
        )
    digits = layout.root.name.rpartition("_")[2]
    projection = read_calibration(layout.poses.parent / "calib.txt", int(digits) if digits.isdecimal() else 0)
    rotations, centers = kitti_poses(rows, projection)
    fx, fy, cx, cy = projection[0, 0], projection[1, 1], projection[0, 2], projection[1, 2]
    cameras: dict[Camera, int] = {}
    kept, ids = [], []
    for i, name in enumerate(layout.names):
        size = _size_of(layout.root / name)
        if size is not None:
            kept.append(i)
            ids.append(cameras.setdefault(Camera.pinhole(*size, fx, fy, cx, cy), len(cameras)))
    return Reconstruction(
        cameras=tuple(cameras),
        names=tuple(layout.names[i] for i in kept),
        camera_ids=np.array(ids, dtype=np.int64),
        rotations=rotations[kept],
        translations=-np.einsum("nij,nj->ni", rotations[kept], centers[kept]),
    )


def _size_of(path: Path) -> tuple[int, int] | None:
    """[px] of the upright photo, or None for a file that will be skipped."""
    try:
        header = read_header(path)
    except UnusableError:
        return None
    return header.width, header.height
