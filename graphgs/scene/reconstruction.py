"""A reconstruction: cameras, posed images, points and their tracks, as plain arrays."""

import dataclasses
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from graphgs.scene.camera import Camera
from graphgs.scene.similarity import Similarity


def _empty(*shape: int, dtype=np.float64):
    return lambda: np.zeros(shape, dtype)


@dataclass(frozen=True)
class Reconstruction:
    """Camera poses with intrinsics, and the points they see. Image order is sorted by name."""

    cameras: tuple[Camera, ...]
    names: tuple[str, ...]  # [N] registered images
    camera_ids: np.ndarray  # [N] int, into `cameras`
    rotations: np.ndarray  # [N, 3, 3] camera-from-world
    translations: np.ndarray  # [N, 3] camera-from-world
    points: np.ndarray = field(default_factory=_empty(0, 3))  # [P, 3] world
    colors: np.ndarray = field(default_factory=_empty(0, 3, dtype=np.uint8))  # [P, 3] RGB
    errors: np.ndarray = field(default_factory=_empty(0))  # [P] mean reprojection error, px
    track_offsets: np.ndarray = field(default_factory=_empty(1, dtype=np.int64))  # [P + 1] into the two arrays below
    track_images: np.ndarray = field(default_factory=_empty(0, dtype=np.int32))  # [T] image index of an observation
    track_xy: np.ndarray = field(default_factory=_empty(0, 2))  # [T, 2] px, where it was seen

    @property
    def centers(self) -> np.ndarray:
        """[N, 3] camera centres in the world."""
        return -np.einsum("nji,nj->ni", self.rotations, self.translations)

    @property
    def track_lengths(self) -> np.ndarray:
        """[P] observations per point."""
        return np.diff(self.track_offsets)

    @property
    def viewmats(self) -> np.ndarray:
        """[N, 4, 4] world-to-camera."""
        m = np.tile(np.eye(4), (len(self.names), 1, 1))
        m[:, :3, :3], m[:, :3, 3] = self.rotations, self.translations
        return m

    def camera_of(self, image: int) -> Camera:
        return self.cameras[int(self.camera_ids[image])]

    def of_images(
        self,
        chosen: np.ndarray,  # [M] int, sorted
    ) -> "Reconstruction":
        """Only some of the images; points stay, their tracks without the others."""
        new_of_old = np.full(len(self.names), -1, np.int32)
        new_of_old[chosen] = np.arange(len(chosen))
        images = new_of_old[self.track_images]
        stays = images >= 0
        return dataclasses.replace(
            self,
            names=tuple(self.names[k] for k in chosen),
            camera_ids=self.camera_ids[chosen],
            rotations=self.rotations[chosen],
            translations=self.translations[chosen],
            track_offsets=np.concatenate([[0], np.cumsum(stays)])[self.track_offsets].astype(np.int64),
            track_images=images[stays],
            track_xy=self.track_xy[stays],
        )

    def transformed(self, new_from_old: Similarity) -> "Reconstruction":
        """The same scene in another world frame."""
        rotations = self.rotations @ new_from_old.rotation.T
        centers = new_from_old.apply(self.centers)
        return dataclasses.replace(
            self,
            rotations=rotations,
            translations=-np.einsum("nij,nj->ni", rotations, centers),
            points=new_from_old.apply(self.points),
        )

    def save(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        arrays = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in ("cameras", "names")}
        np.savez(folder / "reconstruction.npz", **arrays)
        header = {"cameras": [dataclasses.asdict(c) for c in self.cameras], "names": list(self.names)}
        (folder / "reconstruction.json").write_text(json.dumps(header, indent=1))

    @staticmethod
    def load(folder: Path) -> "Reconstruction":
        header = json.loads((folder / "reconstruction.json").read_text())
        cameras = tuple(Camera(c["model"], c["width"], c["height"], tuple(c["params"])) for c in header["cameras"])
        with np.load(folder / "reconstruction.npz", allow_pickle=False) as arrays:
            return Reconstruction(cameras=cameras, names=tuple(header["names"]), **dict(arrays))
