"""Camera paths as rows of numbers: KITTI's poses.txt with its calib.txt, and TUM trajectories."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from graphgs.errors import DataError

KITTI_COLUMNS, TUM_COLUMNS = 12, 8
HINT = "expected are rows of 12 numbers (KITTI: camera-to-world, 3x4) or 8 (TUM: time tx ty tz qx qy qz qw)"


def read_rows(path: Path) -> np.ndarray:
    """[N, 8] or [N, 12] finite numbers of a text file; # begins a comment."""
    try:
        lines = (line.split("#")[0].replace(",", " ").split() for line in path.read_text(encoding="utf-8").splitlines())
        rows = np.array([[float(value) for value in line] for line in lines if line])
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: not a list of poses: {error}", hint=HINT) from None
    if rows.ndim != 2 or rows.shape[1] not in (KITTI_COLUMNS, TUM_COLUMNS) or not np.isfinite(rows).all():
        raise DataError(f"{path}: not a list of poses", hint=HINT)
    return rows


def is_kitti(path: Path) -> bool:
    """True if the file holds KITTI poses."""
    try:
        return read_rows(path).shape[1] == KITTI_COLUMNS
    except DataError:
        return False


def kitti_poses(
    rows: np.ndarray,  # [N, 12] camera-to-world of the left camera, x right, y down, z forward
    projection: np.ndarray | None = None,  # [3, 4] of the camera in question, relative to the left one
) -> tuple[np.ndarray, np.ndarray]:
    """(rotations [N, 3, 3] camera-from-world, centers [N, 3])."""
    poses = rows.reshape(-1, 3, 4)
    u, d, vt = np.linalg.svd(poses[:, :, :3])
    if (np.abs(d - 1) > 0.01).any() or (np.linalg.det(u @ vt) < 0).any():
        raise DataError("a KITTI pose holds no rotation", hint=HINT)
    world_from_cam = u @ vt  # the nearest rotation: the files carry seven digits
    centers = poses[:, :, 3]
    if projection is not None:
        # P = K [I | t] with x_cam = x_left + t, so the camera sits at -t in the left camera's frame.
        centers = centers - world_from_cam @ np.linalg.solve(projection[:, :3], projection[:, 3])
    return world_from_cam.transpose(0, 2, 1), centers


def tum_poses(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(times [N] s, rotations [N, 3, 3] camera-from-world, centers [N, 3]) of rows [N, 8], camera-to-world."""
    if (np.linalg.norm(rows[:, 4:], axis=1) < 1e-6).any():
        raise DataError("a TUM pose has no rotation", hint=HINT)
    return rows[:, 0], Rotation.from_quat(rows[:, 4:]).inv().as_matrix(), rows[:, 1:4]


def read_calibration(path: Path, camera: int = 0) -> np.ndarray:
    """[3, 4] projection matrix P of one camera of a KITTI calib.txt ("P0: ..." lines, or bare rows in that order)."""
    matrices = []
    try:
        for line in path.read_text(encoding="utf-8").splitlines():
            label, _, numbers = line.rpartition(":")
            if numbers.strip() and (not label or label.strip().startswith("P")):
                matrices.append(np.array([float(value) for value in numbers.split()]).reshape(3, 4))
        projection = matrices[camera]
        if not np.isfinite(projection).all() or projection[0, 0] <= 0 or projection[1, 1] <= 0:
            raise ValueError("no focal length")
    except (OSError, ValueError, IndexError) as error:
        raise DataError(
            f"{path}: no projection matrix of camera {camera}: {error}",
            hint="KITTI poses need calib.txt beside them; without it, give the folder of photos alone",
        ) from None
    return projection
