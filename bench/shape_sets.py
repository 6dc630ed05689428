"""The photo sets of the scoreboard of shapes: what is photographed, where, and how it truly is."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.shape_truth import Truth, gps_truth, model_truth, of_photos, pose_rows_truth, transforms_truth
from graphgs.scene.colmap import read_model

PHOTO_SUFFIXES = {".jpg", ".jpeg", ".png"}
KITTI_RIG_FOCAL = 721.5377 / 1242  # of its rectified photos
KITTI_RIG_NOISE, SENECA_NOISE = 0.3, 2.0  # [m]: what their truth is good for, by who recorded it


@dataclass(frozen=True)
class ShapeSet:
    name: str
    images: Path  # folder; photos in folders below it are other cameras
    photos: tuple[str, ...]  # below `images`
    truth: Truth
    lidar: Path | None = None  # npz with `world` [M, 3] m, in the frame of the true poses
    determined: bool | None = None  # whether the photos can tell their shape, by geometry; None: not asked of real sets
    focal_known_to: float | None = None  # [%] standard deviation that the photos' geometry allows


def photos_below(images: Path) -> tuple[str, ...]:
    return tuple(
        sorted(p.relative_to(images).as_posix() for p in images.rglob("*") if p.suffix.lower() in PHOTO_SUFFIXES)
    )


def real_set(data: Path, name: str) -> ShapeSet:
    """A set of photos taken of the world, with the truth its authors measured."""
    folder = data / name
    images = folder / "images"
    photos = photos_below(images)
    return ShapeSet(
        name,
        images,
        photos,
        of_photos(REAL_TRUTHS[name](folder), set(photos)),
        lidar=folder / "lidar.npz" if (folder / "lidar.npz").is_file() else None,
    )


def lidar_points(found: ShapeSet) -> np.ndarray | None:
    if found.lidar is None:
        return None
    with np.load(found.lidar) as arrays:
        return arrays["world"].astype(np.float64)


def _model(folder: Path) -> Truth:
    return model_truth(read_model(folder / "gt_colmap"))


def _kitti_rig(folder: Path) -> Truth:
    rows = {}
    for poses in sorted(folder.glob("poses_cam*.txt")):
        camera = poses.stem.removeprefix("poses_")
        rows[poses] = tuple(f"{camera}/{name}" for name in photos_below(folder / "images" / camera))
    return pose_rows_truth(rows, focal=KITTI_RIG_FOCAL, noise_m=KITTI_RIG_NOISE)


REAL_TRUTHS = {
    "kitti_bend": _model,
    "castle": _model,
    "fountain": _model,
    "fox": lambda folder: transforms_truth(folder / "transforms.json"),
    "kitti_street": _model,
    "seneca_aerial": lambda folder: gps_truth(folder / "images", noise_m=SENECA_NOISE),
    "kitti_rig": _kitti_rig,
}
