"""What is known of the lenses before the photos are asked, and what changes once they answered."""

import numpy as np

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.structure.calibration.lens import PARAMETERS, LensStart
from graphgs.structure.cameras import SharedCameras
from graphgs.structure.focal import TYPICAL_FOCAL

_FEW_PHOTOS = 8  # fewer photos of one camera hardly determine its principal point or a second distortion term


def lens_starts(photos: Photos, model: Reconstruction, cameras: tuple[Camera, ...]) -> tuple[LensStart, ...]:
    """For each camera of a model: these values to start from, and what the photos that it took are told of it."""
    photo_of = {photo.name: photo for photo in photos.photos}
    starts = []
    for k, camera in enumerate(cameras):
        own = [photo_of[name] for name, c in zip(model.names, model.camera_ids, strict=True) if c == k]
        told = [photo.focal_px for photo in own if photo.focal_px]
        origin = "typical" if not told else "given" if all(photo.focal_given for photo in own) else "EXIF"
        focal = float(np.median(told)) if told else TYPICAL_FOCAL * max(camera.width, camera.height)
        starts.append(LensStart(camera, focal, origin))
    return tuple(starts)


def wide_open(cameras: SharedCameras) -> tuple[str, ...]:
    """What may be refined before any evidence is taken: all, where every camera took photos enough."""
    enough = np.bincount(cameras.camera_ids, minlength=len(cameras.cameras)).min() >= _FEW_PHOTOS
    return PARAMETERS if enough else ("focal", "k1")


def largest_move(before: tuple[Camera, ...], after: tuple[Camera, ...]) -> float:
    """The largest change of a focal length, relative, or of the distortion at a corner, to the distance from the
    middle."""
    return max(max(_focal_move(a, b), _bending_move(a, b)) for a, b in zip(before, after, strict=True))


def _focal_move(before: Camera, after: Camera) -> float:
    return abs(float(np.log(after.focal_and_center[0] / before.focal_and_center[0])))


def _bending_move(before: Camera, after: Camera) -> float:
    return abs(_bending(after) - _bending(before))


def _bending(camera: Camera) -> float:
    """By how much distortion moves the image's corner, relative to its distance from the middle."""
    corner2 = (camera.width**2 + camera.height**2) / (4 * camera.focal_and_center[0] ** 2)
    k1, k2 = (*camera.distortion, 0.0, 0.0)[:2]
    return k1 * corner2 + k2 * corner2**2
