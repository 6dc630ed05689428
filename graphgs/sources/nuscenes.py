"""Poses as a JSON list in nuScenes' terms, one object per image:

    {"filename": "CAM_FRONT/0001.jpg",                  relative to the file's folder
     "rotation": [w, x, y, z], "translation": [x, y, z],  camera to world: x right, y down, z forward; metres
     "camera_intrinsic": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]],
     "ego_pose": {"rotation": ..., "translation": ...}}   optional: then the two above are camera to vehicle

These are the fields of calibrated_sensor, ego_pose and sample_data (nuscenes.org, schema), joined.
"""

import json
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from graphgs.errors import DataError
from graphgs.scene.names import inside
from graphgs.sources.transforms import MAX_BYTES, Frame, Transforms, read_transforms

HINT = "expected is a list of {filename, rotation, translation, camera_intrinsic}, as docs/pipeline.md describes it"


def read_pose_json(path: Path) -> Transforms:
    """A transforms.json, or a list in nuScenes' terms: told apart by the first character."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            head = file.read(1000).lstrip()
    except (OSError, UnicodeDecodeError):
        head = ""  # the reader says what is wrong
    return read_nuscenes(path) if head.startswith("[") else read_transforms(path)


def read_nuscenes(path: Path) -> Transforms:
    """The frames of such a list, sorted by name. Raises DataError."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError("larger than 200 MB")
        entries = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"{path}: not a JSON file: {error}", hint=HINT) from None
    frames = []
    for i, entry in enumerate(entries):
        try:
            frames.append(_frame(entry))
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            what = f"{error} is missing" if isinstance(error, KeyError) else str(error)
            raise DataError(f"{path}: entry {i}: {what}", hint=HINT) from None
    names = [frame.name for frame in frames]
    if not names or len(set(names)) < len(names):
        raise DataError(f"{path}: no image, or one named twice", hint=HINT)
    return Transforms(path, tuple(sorted(frames, key=lambda frame: frame.name)))


def _frame(entry: dict) -> Frame:
    if not isinstance(entry, dict):
        raise ValueError("not an object")
    name = inside(entry["filename"]) if isinstance(entry["filename"], str) else None
    if name is None:
        raise ValueError(f"{str(entry['filename'])[:200]!a} leads out of the data folder")
    K = np.array(entry["camera_intrinsic"], dtype=np.float64)
    if K.shape != (3, 3) or not np.isfinite(K).all() or min(K[0, 0], K[1, 1]) <= 0:
        raise ValueError("camera_intrinsic: expected 3x3 numbers with positive focal lengths")
    rotation, center = _pose(entry)
    if entry.get("ego_pose") is not None:
        world_from_ego, place = _pose(entry["ego_pose"])
        rotation, center = world_from_ego @ rotation, world_from_ego @ center + place
    return Frame(
        name=name,
        mask=None,
        rotation=rotation.T,
        center=center,
        intrinsics={"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]},
        fisheye=False,
    )


def _pose(record: dict) -> tuple[np.ndarray, np.ndarray]:
    """(rotation [3, 3], translation [3]) as written: from the sensor to what it is mounted on, or to the world."""
    quaternion, place = (np.array(record[key], dtype=np.float64) for key in ("rotation", "translation"))
    if quaternion.shape != (4,) or place.shape != (3,) or not np.isfinite([*quaternion, *place]).all():
        raise ValueError("rotation: expected 4 and translation: expected 3 finite numbers")
    if not 0.99 < np.linalg.norm(quaternion) < 1.01:
        raise ValueError("rotation: expected a unit quaternion w, x, y, z")
    return Rotation.from_quat(quaternion[[1, 2, 3, 0]]).as_matrix(), place
