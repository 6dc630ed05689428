"""Pictures through a lens that bends straight lines: pinhole pictures, resampled."""

import math

import cv2
import numpy as np

from graphgs.scene.camera import Camera

FINER = 1.5  # pinhole pixels per pixel and axis: resampling then costs no sharpness


class Lens:
    """Makes the photos of a SIMPLE_RADIAL camera from a pinhole camera's pictures."""

    def __init__(self, camera: Camera):
        fx, fy, cx, cy = camera.focal_and_center
        self.camera = camera
        # between pixels and half pixels: the finer grid that is averaged to the photo
        columns, rows = (
            (np.arange(math.ceil(FINER * side)) + 0.5) * side / math.ceil(FINER * side)
            for side in (camera.width, camera.height)
        )
        grid = np.stack(np.meshgrid((columns - cx) / fx, (rows - cy) / fy), axis=-1)
        rays = undistorted(grid, camera)
        reach = np.abs(rays).reshape(-1, 2).max(0)
        width, height = (2 * math.ceil(FINER * f * side + 2) for f, side in zip((fx, fy), reach, strict=True))
        self.pinhole = Camera.pinhole(width, height, FINER * fx, FINER * fy, width / 2, height / 2)
        where = rays * [FINER * fx, FINER * fy] + [width / 2 - 0.5, height / 2 - 0.5]  # remap counts from pixel centres
        self._where = where.astype(np.float32)

    def photograph(
        self,
        picture: np.ndarray,  # [H, W, 3] uint8, taken with `pinhole`
    ) -> np.ndarray:
        """[h, w, 3] uint8, what the camera would have taken."""
        fine = cv2.remap(picture, self._where[..., 0], self._where[..., 1], cv2.INTER_LINEAR)
        return cv2.resize(fine, (self.camera.width, self.camera.height), interpolation=cv2.INTER_AREA)


def distorted(
    xy: np.ndarray,  # [..., 2] on the plane z = 1
    camera: Camera,  # SIMPLE_RADIAL
) -> np.ndarray:
    """[..., 2] where the lens puts them on that plane; COLMAP's model."""
    return xy * (1.0 + camera.distortion[0] * (xy**2).sum(-1, keepdims=True))


def undistorted(
    xy: np.ndarray,  # [..., 2] on the plane z = 1, as the lens puts them there
    camera: Camera,  # SIMPLE_RADIAL
) -> np.ndarray:
    """[..., 2] the plane's points; the inverse of `distorted`, by iteration."""
    points = xy
    for _ in range(20):  # each step takes off nine tenths of the error and more, for the weak lenses made here
        points = xy / (1.0 + camera.distortion[0] * (points**2).sum(-1, keepdims=True))
    return points
