"""transforms.json (nerfstudio, instant-ngp): camera-to-world with OpenGL axes, intrinsics per file or frame.

OpenGL cameras look along -z with y up; ours look along +z with y down, so the camera's y and z axes change sign.
"""

import dataclasses
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.errors import DataError
from graphgs.scene.camera import Camera
from graphgs.scene.names import inside
from graphgs.scene.reconstruction import Reconstruction

MAX_BYTES = 200_000_000
OURS_FROM_OPENGL = np.diag([1.0, -1.0, -1.0])
GUESSED_SUFFIXES = (".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")  # for paths written without one
KEYS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2", "camera_angle_x", "camera_angle_y")
MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV_FISHEYE", "PERSPECTIVE")
HINT = "expected is the format of nerfstudio or instant-ngp (docs.nerf.studio, data conventions)"


@dataclass(frozen=True)
class Frame:
    """One image of the file."""

    name: str  # POSIX path relative to the file's folder
    mask: str | None  # likewise
    rotation: np.ndarray  # [3, 3] camera-from-world
    center: np.ndarray  # [3] world
    intrinsics: dict[str, float]  # those of KEYS that are given
    fisheye: bool

    def camera(self, width: int, height: int) -> Camera:
        """Intrinsics; the size [px] is that of the image, for files that do not tell it themselves."""
        given = self.intrinsics
        w, h = int(given.get("w", width)), int(given.get("h", height))
        fx = given.get("fl_x") or _focal(w, given.get("camera_angle_x"))
        fy = given.get("fl_y") or _focal(h, given.get("camera_angle_y")) or fx
        fx = fx or fy
        if not fx or not fy:
            raise ValueError("no focal length (fl_x or camera_angle_x)")
        pinhole = (fx, fy, given.get("cx", w / 2), given.get("cy", h / 2))
        k1, k2, k3, k4, p1, p2 = (given.get(key, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
        if self.fisheye:
            return Camera("OPENCV_FISHEYE", w, h, (*pinhole, k1, k2, k3, k4))
        if k4:
            raise ValueError("k4 belongs to a fisheye camera, and this is none")
        if k3:
            return Camera("FULL_OPENCV", w, h, (*pinhole, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0))
        if k1 or k2 or p1 or p2:
            return Camera("OPENCV", w, h, (*pinhole, k1, k2, p1, p2))
        return Camera("PINHOLE", w, h, pinhole)


@dataclass(frozen=True)
class Transforms:
    """The posed frames of one file, or folder of files, sorted by name."""

    path: Path
    frames: tuple[Frame, ...]
    axes: str = "opencv"  # of the cameras in the file; `frames` have ours

    def renamed(self, prefix: str) -> "Transforms":
        """Names relative to the folder `prefix`, below which all of them lie."""
        frames = (dataclasses.replace(frame, name=frame.name.removeprefix(prefix)) for frame in self.frames)
        return dataclasses.replace(self, frames=tuple(sorted(frames, key=lambda frame: frame.name)))

    def reconstruction(self, size_of: Callable[[str], tuple[int, int] | None]) -> Reconstruction:
        """Poses and cameras of the frames whose image has a size: `size_of` gives (width, height), or None."""
        cameras: dict[Camera, int] = {}
        kept, ids = [], []
        for frame in self.frames:
            size = size_of(frame.name)
            if size is None:
                continue
            try:
                camera = frame.camera(*size)
            except ValueError as error:
                raise DataError(f"{self.path}: frame {frame.name!a}: {error}", hint=HINT) from None
            kept.append(frame)
            ids.append(cameras.setdefault(camera, len(cameras)))
        rotations = np.array([frame.rotation for frame in kept]).reshape(-1, 3, 3)
        centers = np.array([frame.center for frame in kept]).reshape(-1, 3)
        return Reconstruction(
            cameras=tuple(cameras),
            names=tuple(frame.name for frame in kept),
            camera_ids=np.array(ids, dtype=np.int64),
            rotations=rotations,
            translations=-np.einsum("nij,nj->ni", rotations, centers),
        )


def read_transforms(path: Path) -> Transforms:
    """Read and check a transforms.json. Raises DataError; a path that leaves the file's folder is one."""
    data = _load(path)
    frames = []
    for i, entry in enumerate(data["frames"]):
        try:
            frames.append(_frame(path.parent, data, entry))
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            what = f"{error} is missing" if isinstance(error, KeyError) else str(error)
            raise DataError(f"{path}: frame {i}: {what}", hint=HINT) from None
    names = [frame.name for frame in frames]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise DataError(
            f"{path}: {twice!a} is named by two frames", hint="each image can have one pose; remove the other"
        )
    return Transforms(path, tuple(sorted(frames, key=lambda frame: frame.name)), axes="opengl")


def _load(path: Path) -> dict:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError("larger than 200 MB")
        data = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(data, dict) or not isinstance(data.get("frames"), list) or not data["frames"]:
            raise ValueError("no list of frames")
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"{path}: not a transforms.json: {error}", hint=HINT) from None
    return data


def _frame(folder: Path, data: dict, entry: dict) -> Frame:
    if not isinstance(entry, dict):
        raise ValueError("not an object")
    model = str(entry.get("camera_model", data.get("camera_model", "OPENCV"))).upper()
    if model not in MODELS:
        raise ValueError(f"camera model {model[:40]!a} is not supported; one of {', '.join(MODELS)} is")
    intrinsics = {}
    for key in KEYS:
        value = entry.get(key, data.get(key))
        if value is not None:
            intrinsics[key] = float(value)
            if not math.isfinite(intrinsics[key]):
                raise ValueError(f"{key} is {value}")
    rotation, center = _pose(entry["transform_matrix"])
    return Frame(
        name=_with_suffix(folder, _relative(folder, entry["file_path"])),
        mask=_relative(folder, entry["mask_path"]) if entry.get("mask_path") else None,
        rotation=rotation,
        center=center,
        intrinsics=intrinsics,
        fisheye=model == "OPENCV_FISHEYE" or bool(entry.get("is_fisheye", data.get("is_fisheye", False))),
    )


def _relative(folder: Path, text) -> str:
    """A path as the file spells it, relative to the file's folder; absolute ones only if they lie inside."""
    if not isinstance(text, str):
        raise ValueError("a path is not text")
    base = folder.absolute().as_posix().rstrip("/") + "/"
    name = inside(text.removeprefix(base))
    if name is None:
        raise ValueError(f"{text[:200]!a} leads out of the data folder")
    return name


def _with_suffix(folder: Path, name: str) -> str:
    """`name`, or the file that only lacks its ending."""
    if not (folder / name).is_file():
        for suffix in GUESSED_SUFFIXES:
            if (folder / (name + suffix)).is_file():
                return name + suffix
    return name


def _pose(matrix) -> tuple[np.ndarray, np.ndarray]:
    """(camera-from-world rotation [3, 3], centre [3]) of a camera-to-world matrix with OpenGL axes."""
    m = np.array(matrix, dtype=np.float64)
    if m.shape not in ((4, 4), (3, 4)) or not np.isfinite(m).all():
        raise ValueError("transform_matrix: expected 4x4 finite numbers")
    u, d, vt = np.linalg.svd(m[:3, :3])
    if np.linalg.det(m[:3, :3]) <= 0 or d[0] > 1.02 * d[2]:
        raise ValueError("transform_matrix holds no rotation")
    return OURS_FROM_OPENGL @ (u @ vt).T, m[:3, 3]  # the nearest rotation: files carry few digits, or a scale


def _focal(side: int, angle: float | None) -> float | None:
    """[px] focal length of a field of view [rad] across `side` px."""
    if angle is None:
        return None
    if not 0 < angle < math.pi:
        raise ValueError(f"a field of view of {angle} rad is impossible")
    return 0.5 * side / math.tan(0.5 * angle)
