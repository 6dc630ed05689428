"""Undistorted pinhole images at the training size, from the decoded photos and the final cameras."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from graphgs.errors import DataError, DiskError
from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.views import Views
from graphgs.sources.photos import Photo, Photos

_HALF = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])  # pixel centres at +0.5 -> OpenCV's at 0
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]
_SANE_ZOOM = (0.5, 2.0)  # of the focal length: outside, the distortion is extreme and the frame is not fitted to it


@dataclass(frozen=True)
class Rectifier:
    """The map from a photo of one camera, resized to its size, to a pinhole image of the same size."""

    camera: Camera  # at the training size

    @cached_property
    def K(self) -> np.ndarray:
        """[3, 3] of the pinhole image, px: the largest frame without blank pixels where distortion allows one."""
        camera = self.camera
        if not np.any(camera.distortion):
            return camera.K
        if camera.is_fisheye:
            return camera.K
        fitted, _ = cv2.getOptimalNewCameraMatrix(
            _HALF @ camera.K, camera.distortion, (camera.width, camera.height), 0.0
        )
        zoom = np.array([fitted[0, 0] / camera.K[0, 0], fitted[1, 1] / camera.K[1, 1]])
        if not np.all((zoom > _SANE_ZOOM[0]) & (zoom < _SANE_ZOOM[1])):
            return camera.K
        return np.linalg.inv(_HALF) @ fitted

    @cached_property
    def maps(self) -> tuple[np.ndarray, np.ndarray] | None:
        """([H, W] x, [H, W] y) in OpenCV's pixels of the photo; None where nothing has to be done."""
        camera = self.camera
        if not np.any(camera.distortion):
            return None
        size, given, wanted = (camera.width, camera.height), _HALF @ camera.K, _HALF @ self.K
        if camera.is_fisheye:
            return cv2.fisheye.initUndistortRectifyMap(given, camera.distortion, np.eye(3), wanted, size, cv2.CV_32FC1)
        return cv2.initUndistortRectifyMap(given, camera.distortion, None, wanted, size, cv2.CV_32FC1)

    @cached_property
    def blank(self) -> np.ndarray | None:
        """[H, W] bool: pixels that no part of the photo falls on; None where there is none."""
        if self.maps is None:
            return None
        x, y = self.maps
        outside = (x < -0.5) | (y < -0.5) | (x > self.camera.width - 0.5) | (y > self.camera.height - 0.5)
        return outside if outside.any() else None

    def image(self, photo: np.ndarray) -> np.ndarray:  # [H, W, 3] uint8 at any size
        photo = _resized(photo, self.camera.width, self.camera.height)
        if self.maps is None:
            return photo
        return cv2.remap(photo, *self.maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)

    def mask(self, mask: np.ndarray | None) -> np.ndarray | None:  # [H, W] uint8, 0 = ignore
        """The mask of the undistorted image; None = every pixel counts."""
        if mask is not None:
            mask = cv2.resize(mask, (self.camera.width, self.camera.height), interpolation=cv2.INTER_NEAREST)
            if self.maps is not None:
                mask = cv2.remap(mask, *self.maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        if self.blank is not None:
            mask = np.full(self.blank.shape, 255, np.uint8) if mask is None else mask
            mask = np.where(self.blank, 0, mask).astype(np.uint8)
        return mask


def undistort(
    max_side: int | None,  # [px] long side of the views; None = the decoded size
    photos: Photos,
    reconstruction: Reconstruction,
    folder: Path,
    *,
    reporter: Reporter,
    threads: int,
) -> Views:
    """Write images/ and masks/ below `folder`, one per placed photo. Raises DataError where a decoded photo is gone,
    DiskError where the folder cannot be written."""
    by_name = {photo.name: photo for photo in photos.photos}
    rectifiers: dict[Camera, Rectifier] = {}
    jobs = []
    for i, name in enumerate(reconstruction.names):
        photo = by_name[name]
        camera = reconstruction.camera_of(i)
        camera = camera.scaled_to(*training_size(camera.width, camera.height, max_side))
        jobs.append((i, photo, rectifiers.setdefault(camera, Rectifier(camera))))
    for rectifier in rectifiers.values():  # before threads share them
        _ = rectifier.K, rectifier.blank
    for name in ("images", "masks"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    masks: list[str | None] = []
    with ThreadPoolExecutor(max(1, threads), thread_name_prefix="undistort") as pool:
        results = pool.map(lambda job: _write(photos.folder, folder, *job), jobs)
        for done, mask in enumerate(results, 1):
            masks.append(mask)
            reporter.progress(done, len(jobs), "undistorting")
    held_out = {name for name, test in zip(photos.names, photos.is_test, strict=True) if test}
    views = Views(
        folder=folder,
        names=reconstruction.names,
        images=tuple(_file("images", i) for i in range(len(jobs))),
        masks=tuple(masks),
        sizes=np.array([(r.camera.width, r.camera.height) for _, _, r in jobs], dtype=np.int64).reshape(-1, 2),
        Ks=np.array([r.K for _, _, r in jobs]).reshape(-1, 3, 3),
        viewmats=reconstruction.viewmats,
        is_test=np.array([name in held_out for name in reconstruction.names], dtype=bool),
        missing_test=tuple(sorted(held_out - set(reconstruction.names))),
    )
    reporter.event("views", count=len(jobs), cameras=len(rectifiers), masked=sum(m is not None for m in masks))
    return views


def training_size(width: int, height: int, max_side: int | None) -> tuple[int, int]:
    """Width and height shrunk to `max_side`, never enlarged."""
    scale = 1.0 if max_side is None else min(1.0, max_side / max(width, height))
    return max(1, round(width * scale)), max(1, round(height * scale))


def _resized(image: np.ndarray, width: int, height: int) -> np.ndarray:
    if image.shape[1] == width and image.shape[0] == height:
        return image
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)


def _write(source: Path, folder: Path, i: int, photo: Photo, rectifier: Rectifier) -> str | None:
    image = cv2.imread(str(source / photo.pixels), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise DataError(f"{photo.name}: its decoded pixels are gone", hint="delete the cache folder and run again")
    mask = None
    if photo.mask is not None:
        mask = cv2.imread(str(source / photo.mask), cv2.IMREAD_GRAYSCALE)
        if mask is None:
            raise DataError(f"{photo.name}: its decoded mask is gone", hint="delete the cache folder and run again")
    _save(folder / _file("images", i), rectifier.image(image))
    mask = rectifier.mask(mask)
    if mask is None:
        return None
    _save(folder / _file("masks", i), mask)
    return _file("masks", i)


def _file(kind: str, i: int) -> str:
    return f"{kind}/{i:06d}.png"


def _save(path: Path, image: np.ndarray) -> None:
    if not cv2.imwrite(str(path), image, _PNG):
        raise DiskError(f"{path}: cannot be written", hint="free some space on the disk; the run continues there")
