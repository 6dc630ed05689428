"""Waymo sequences as they are commonly exported, photos by folder or in one folder:

    FRONT/000000.png, FRONT_LEFT/000000.png, ...   or   images/000000_0.png, images/000000_1.png, ...
    ego_pose/000000.txt      4x4, vehicle to world
    extrinsics/0.txt         4x4, camera to vehicle (x forward, y left, z up); also named FRONT.txt
    intrinsics/0.txt         fx, fy, cx, cy, k1, k2, p1, p2, k3, one number a line or row; also named FRONT.txt

Cameras count 0 FRONT, 1 FRONT_LEFT, 2 FRONT_RIGHT, 3 SIDE_LEFT, 4 SIDE_RIGHT. Waymo's own camera axes (x forward, y
left, z up) and OpenCV's (x right, y down, z forward) are told apart by which axis points up. Without ego_pose/ the
folders are plain photos, and a rig by their names.
"""

import re
from pathlib import Path, PurePosixPath

import numpy as np

from graphgs.errors import DataError
from graphgs.sources.transforms import Frame, Transforms

CAMERAS = ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "SIDE_LEFT", "SIDE_RIGHT")
HINT = "expected are ego_pose/FRAME.txt, extrinsics/CAMERA.txt and intrinsics/CAMERA.txt; --poses prior ignores them"
_OPENCV_FROM_WAYMO = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_FLAT = re.compile(r"(\d+)_([0-4])")
_LENS = ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


def is_waymo(folder: Path) -> bool:
    return all((folder / part).is_dir() for part in ("ego_pose", "extrinsics", "intrinsics"))


def photo_folders(folder: Path) -> tuple[str, ...]:
    """Folders of photos: one per camera, or images/ with all of them."""
    own = tuple(camera for camera in CAMERAS if (folder / camera).is_dir())
    return own or (("images",) if (folder / "images").is_dir() else ())


def read_waymo(folder: Path, names: tuple[str, ...]) -> Transforms:
    """The poses of the named photos; those of a frame without a file in ego_pose/ have none. Raises DataError."""
    cameras, egos, frames = {}, {}, []
    for name in names:
        camera, stem = _camera_and_frame(name)
        if camera is None:
            continue
        if camera not in cameras:
            cameras[camera] = _camera(folder, camera)
        if stem not in egos:
            path = folder / "ego_pose" / f"{stem}.txt"
            egos[stem] = _matrix(path) if path.is_file() else None
        if egos[stem] is None:
            continue
        vehicle_from_camera, lens = cameras[camera]
        world_from_camera = egos[stem] @ vehicle_from_camera
        u, _, vt = np.linalg.svd(world_from_camera[:3, :3])  # files carry few digits
        frames.append(Frame(name, None, (u @ vt).T, world_from_camera[:3, 3], lens, False))
    if not frames:
        raise DataError(f"{folder}: none of its photos has a pose in ego_pose/", hint=HINT)
    return Transforms(folder / "ego_pose", tuple(frames))


def _camera_and_frame(name: str) -> tuple[int | None, str]:
    path = PurePosixPath(name)
    if path.parent.name in CAMERAS:
        return CAMERAS.index(path.parent.name), path.stem
    flat = _FLAT.fullmatch(path.stem)
    return (int(flat[2]), flat[1]) if flat else (None, "")


def _camera(folder: Path, camera: int) -> tuple[np.ndarray, dict[str, float]]:
    """(vehicle from camera [4, 4] with our camera axes, intrinsics) of one camera."""
    places = [folder / "{}" / f"{spelling}.txt" for spelling in (str(camera), CAMERAS[camera])]
    extrinsics, intrinsics = (
        next((path for place in places if (path := Path(str(place).format(part))).is_file()), None)
        for part in ("extrinsics", "intrinsics")
    )
    if extrinsics is None or intrinsics is None:
        raise DataError(f"{folder}: no extrinsics or intrinsics of camera {camera} ({CAMERAS[camera]})", hint=HINT)
    matrix = _matrix(extrinsics)
    if matrix[2, 2] > 0.5:  # the camera's z points up
        matrix[:3, :3] = matrix[:3, :3] @ _OPENCV_FROM_WAYMO.T
    elif matrix[2, 1] > -0.5:  # nor does its y point down
        raise DataError(f"{extrinsics}: the camera is not upright by Waymo's axes, nor by OpenCV's", hint=HINT)
    numbers = _numbers(intrinsics)
    if len(numbers) < 4 or min(numbers[:2]) <= 0:
        raise DataError(f"{intrinsics}: expected fx, fy, cx, cy and distortion", hint=HINT)
    return matrix, dict(zip(_LENS, numbers[: len(_LENS)].tolist(), strict=False))


def _matrix(path: Path) -> np.ndarray:
    """[4, 4]"""
    numbers = _numbers(path)
    if len(numbers) == 12:
        numbers = np.r_[numbers, 0, 0, 0, 1]
    matrix = numbers.reshape(4, 4) if len(numbers) == 16 else np.zeros((4, 4))
    if np.abs(matrix[:3, :3] @ matrix[:3, :3].T - np.eye(3)).max() > 0.01 or np.linalg.det(matrix[:3, :3]) < 0:
        raise DataError(f"{path}: expected 4x4 numbers with a rotation", hint=HINT)
    return matrix


def _numbers(path: Path) -> np.ndarray:
    try:
        found = np.array([float(v) for v in path.read_text(encoding="utf-8").replace(",", " ").split()])
        if not np.isfinite(found).all():
            raise ValueError("not finite")
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: no numbers: {error}", hint=HINT) from None
    return found
