"""Intrinsics shared by photos: where they start from, and what a reconstruction makes of them."""

import dataclasses

import numpy as np

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.structure.focal import TYPICAL_FOCAL


@dataclasses.dataclass(frozen=True)
class SharedCameras:
    """The cameras of a set of photos: photos with the same `camera_key` share one."""

    cameras: tuple[Camera, ...]
    known: tuple[bool, ...]  # the focal length is from EXIF or a reconstruction, not a guess
    camera_ids: np.ndarray  # [N] int, into `cameras`

    def records(self) -> list[dict]:
        """Plain values, one per camera, as COLMAP's worker takes them."""
        return [{**dataclasses.asdict(c), "known": k} for c, k in zip(self.cameras, self.known, strict=True)]

    @staticmethod
    def from_records(records: list[dict], camera_ids: np.ndarray) -> "SharedCameras":
        cameras = [Camera(r["model"], r["width"], r["height"], tuple(r["params"])) for r in records]
        return SharedCameras(tuple(cameras), tuple(r["known"] for r in records), camera_ids)


def shared_cameras(photos: Photos) -> SharedCameras:
    """SIMPLE_RADIAL per camera key, with the focal length of EXIF or a typical one: one distortion term is all that few
    features at low resolution can carry."""
    keys = sorted({photo.camera_key for photo in photos.photos})
    cameras, known = [], []
    for key in keys:
        group = [photo for photo in photos.photos if photo.camera_key == key]
        width, height = group[0].width, group[0].height
        told = [photo.focal_px for photo in group if photo.focal_px]
        focal = float(np.median(told)) if told else TYPICAL_FOCAL * max(width, height)
        cameras.append(Camera("SIMPLE_RADIAL", width, height, (focal, width / 2, height / 2, 0.0)))
        known.append(bool(told))
    ids = np.array([keys.index(photo.camera_key) for photo in photos.photos], dtype=np.int64)
    return SharedCameras(tuple(cameras), tuple(known), ids)


def rescaled(cameras: SharedCameras, scale: float) -> SharedCameras:
    """The focal lengths that were guessed, times `scale`, as known ones from now on."""
    changed = [
        camera if known else dataclasses.replace(camera, params=(camera.params[0] * scale, *camera.params[1:]))
        for camera, known in zip(cameras.cameras, cameras.known, strict=True)
    ]
    return dataclasses.replace(cameras, cameras=tuple(changed), known=(True,) * len(changed))


def with_lenses(
    cameras: SharedCameras, photos: Photos, model: Reconstruction, lenses: tuple[Camera, ...]
) -> SharedCameras:
    """The cameras with the lenses of a model of these photos, where it has them, as known ones."""
    row = {name: k for k, name in enumerate(photos.names)}
    changed, known = list(cameras.cameras), list(cameras.known)
    for name, own in zip(model.names, model.camera_ids, strict=True):
        camera = int(cameras.camera_ids[row[name]])
        changed[camera], known[camera] = lenses[int(own)], True
    return dataclasses.replace(cameras, cameras=tuple(changed), known=tuple(known))


def with_cameras(reconstruction: Reconstruction, cameras: SharedCameras, names: tuple[str, ...]) -> Reconstruction:
    """The reconstruction with these intrinsics in place of its own. `names` [N] are those of `cameras.camera_ids`."""
    camera_of = dict(zip(names, cameras.camera_ids, strict=True))
    ids = np.array([camera_of[name] for name in reconstruction.names], dtype=np.int64)
    return dataclasses.replace(reconstruction, cameras=cameras.cameras, camera_ids=ids)
