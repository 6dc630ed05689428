"""True cameras of a photo set, from whatever a set's authors wrote them in."""

import dataclasses
import json
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.exif import read_exif
from graphgs.structure.gps import enu_from_wgs84


@dataclass(frozen=True)
class Truth:
    """Where the photos were taken, how they were turned, with which lens; what is not known is None."""

    names: tuple[str, ...]  # [N] photos, below the set's folder of images
    centers: np.ndarray  # [N, 3] world
    rotations: np.ndarray | None = None  # [N, 3, 3] camera-from-world
    focals: np.ndarray | None = None  # [N] focal length / picture width
    up: np.ndarray | None = None  # [3] unit, of sets photographed straight down: their heights can bend
    noise_m: float = 0.0  # of the positions, in their unit; 0: the truth is far better than any reconstruction

    @property
    def index(self) -> dict[str, int]:
        return {name: k for k, name in enumerate(self.names)}


def of_photos(truth: Truth, photos: Collection[str]) -> Truth:
    """Without photos that are not there: a set may be part of a larger one."""
    kept = [k for k, name in enumerate(truth.names) if name in photos]

    def some(array):
        return None if array is None else array[kept]

    return dataclasses.replace(
        truth, names=tuple(truth.names[k] for k in kept), centers=truth.centers[kept],
        rotations=some(truth.rotations), focals=some(truth.focals),
    )  # fmt: skip


def model_truth(model: Reconstruction, *, up: np.ndarray | None = None) -> Truth:
    """The truth as a model with poses and cameras; fx stands for the focal length."""
    cameras = [model.camera_of(k) for k in range(len(model.names))]
    focals = np.array([camera.focal_and_center[0] / camera.width for camera in cameras])
    return Truth(model.names, model.centers, model.rotations, focals, up)


def pose_rows_truth(
    rows: dict[Path, tuple[str, ...]],  # file of camera-to-world 3x4 rows -> the photos they are of
    *,
    focal: float,  # focal length / picture width, of all
    noise_m: float = 0.0,
) -> Truth:
    """KITTI's poses: a line of twelve numbers per photo."""
    names, centers, rotations = [], [], []
    for path, photos in rows.items():
        poses = np.loadtxt(path, ndmin=2).reshape(-1, 3, 4)
        if len(poses) != len(photos):
            raise ValueError(f"{path}: {len(poses)} poses for {len(photos)} photos")
        names += photos
        centers.append(poses[:, :, 3])
        rotations.append(poses[:, :, :3].transpose(0, 2, 1))
    return Truth(
        tuple(names), np.concatenate(centers), np.concatenate(rotations), np.full(len(names), focal), noise_m=noise_m
    )


def transforms_truth(path: Path) -> Truth:
    """A transforms.json: camera-to-world with OpenGL's axes (y up, z backwards)."""
    content = json.loads(path.read_text())
    names = [frame["file_path"].removeprefix("./").removeprefix("images/") for frame in content["frames"]]
    poses = np.array([frame["transform_matrix"] for frame in content["frames"]], float)
    rotations = (poses[:, :3, :3] * [1.0, -1.0, -1.0]).transpose(0, 2, 1)
    focals = np.full(len(names), content["fl_x"] / content["w"])
    return Truth(tuple(names), poses[:, :3, 3], rotations, focals)


def gps_truth(images: Path, *, noise_m: float) -> Truth:
    """Positions alone, east, north and up in metres, from the photos' EXIF data."""
    found = {}
    for path in sorted(images.iterdir()):
        with Image.open(path) as photo:
            position = read_exif(photo).gps
        if position is not None:
            found[path.name] = position
    return Truth(
        tuple(found), enu_from_wgs84(np.array(list(found.values()))), up=np.array([0.0, 0.0, 1.0]), noise_m=noise_m
    )
