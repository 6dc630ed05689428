"""Projection of points into photos with its derivatives: by pose, by point, and by what a camera's lens may be off by.

A lens is varied in coordinates of its own, the same for every camera model: `LENS`. The focal length as a logarithm, so
that .01 is one per cent; the principal point in focal lengths, so that .01 is about half a degree; distortion as COLMAP
has it. They are of one size, which keeps the normal equations well conditioned.
"""

from dataclasses import dataclass

import numpy as np

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction

LENS = ("focal", "center_x", "center_y", "k1", "k2")
_STEP = 1e-6  # of the central difference through the distortion
_NEWTON = 5


@dataclass(frozen=True)
class Linearised:
    """Residuals and first derivatives of M observations. A pose is varied as p = exp(turn) R (X - C - move)."""

    residuals: np.ndarray  # [M, 2] px, projected minus seen
    by_pose: np.ndarray  # [M, 2, 6] turn [rad] in the camera, move in world units
    by_point: np.ndarray  # [M, 2, 3] world units
    by_lens: np.ndarray  # [M, 2, 5] LENS
    ahead: np.ndarray  # [M] bool: the point lies in front of the camera; where not, everything else is 0


def linearise(
    model: Reconstruction,
    images: np.ndarray,  # [M] int into the model's names
    points: np.ndarray,  # [M, 3] world
    seen: np.ndarray,  # [M, 2] px
) -> Linearised:
    rotations = model.rotations[images]
    local = np.einsum("mij,mj->mi", rotations, points - model.centers[images])
    ahead = local[:, 2] > 0
    z = np.where(ahead, local[:, 2], 1.0)
    rays = local[:, :2] / z[:, None]
    count = len(images)
    residuals, by_rays, by_lens = np.zeros((count, 2)), np.zeros((count, 2, 2)), np.zeros((count, 2, 5))
    camera_ids = model.camera_ids[images]
    for camera_id in np.unique(camera_ids):
        rows = np.flatnonzero(camera_ids == camera_id)
        seen_here = _through_lens(model.cameras[int(camera_id)], rays[rows])
        residuals[rows], by_rays[rows], by_lens[rows] = seen_here[0] - seen[rows], *seen_here[1:]
    by_local = np.zeros((count, 2, 3))
    by_local[:, :, :2] = by_rays / z[:, None, None]
    by_local[:, :, 2] = -np.einsum("mij,mj->mi", by_rays, rays) / z[:, None]
    by_point = by_local @ rotations
    by_pose = np.concatenate([-by_local @ _cross(local), -by_point], axis=2)
    for array in (residuals, by_pose, by_point, by_lens):
        array[~ahead] = 0.0
    return Linearised(residuals, by_pose, by_point, by_lens, ahead)


def _through_lens(camera: Camera, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(px [M, 2], derivative by the ray [M, 2, 2], derivative by LENS [M, 2, 5]) of rays [M, 2] = x/z, y/z."""
    fx, fy, cx, cy = camera.focal_and_center
    focal = np.array([fx, fy])
    bent = distort(camera, rays)
    by_rays = np.empty((len(rays), 2, 2))
    for axis, step in enumerate(_STEP * np.eye(2)):
        slope = (distort(camera, rays + step) - distort(camera, rays - step)) / (2 * _STEP)
        by_rays[:, :, axis] = focal * slope
    by_lens = np.zeros((len(rays), 2, 5))
    by_lens[:, :, 0] = focal * bent
    by_lens[:, 0, 1], by_lens[:, 1, 2] = fx, fx
    radius2 = (rays**2).sum(1)
    if camera.is_fisheye:  # theta + k1 theta^3 + k2 theta^5 along the ray's direction
        radius = np.sqrt(np.maximum(radius2, 1e-24))
        theta = np.arctan(radius)
        terms = np.stack([theta**3, theta**5], axis=1) / radius[:, None]
    else:
        terms = np.stack([radius2, radius2**2], axis=1)
    by_lens[:, :, 3:] = (focal * rays)[:, :, None] * terms[:, None, :]
    return bent * focal + [cx, cy], by_rays, by_lens


def distort(camera: Camera, rays: np.ndarray) -> np.ndarray:
    """[M, 2] rays as the lens bends them, in focal lengths from the principal point (COLMAP's models)."""
    p = camera.distortion
    if not len(p):
        return rays
    radius2 = (rays**2).sum(1, keepdims=True)
    if camera.is_fisheye:
        radius = np.sqrt(np.maximum(radius2, 1e-24))
        theta = np.arctan(radius)
        t2 = theta**2
        return rays * theta / radius * (1 + t2 * (p[0] + t2 * (p[1] + t2 * (p[2] + t2 * p[3]))))
    k = np.concatenate([p, np.zeros(8 - len(p))])  # k1 k2 p1 p2 k3 k4 k5 k6
    radial = 1 + radius2 * (k[0] + radius2 * (k[1] + radius2 * k[4]))
    radial = radial / (1 + radius2 * (k[5] + radius2 * (k[6] + radius2 * k[7])))
    u, v = rays[:, :1], rays[:, 1:]
    tangential = np.concatenate(
        [2 * k[2] * u * v + k[3] * (radius2 + 2 * u * u), k[2] * (radius2 + 2 * v * v) + 2 * k[3] * u * v], axis=1
    )
    return rays * radial + tangential


def rays_of(camera: Camera, seen: np.ndarray) -> np.ndarray:
    """[M, 2] x/z, y/z of the rays that a lens brings to px [M, 2], by Newton's method on `distort`."""
    fx, fy, cx, cy = camera.focal_and_center
    bent = (seen - [cx, cy]) / [fx, fy]
    rays = bent.copy()
    for _ in range(_NEWTON):
        slope = np.stack(
            [(distort(camera, rays + h) - distort(camera, rays - h)) / (2 * _STEP) for h in _STEP * np.eye(2)], axis=2
        )
        safe = np.abs(np.linalg.det(slope)) > 0.1  # beyond the edge where the lens's formula turns round
        step = np.linalg.solve(
            np.where(safe[:, None, None], slope, np.eye(2)), (distort(camera, rays) - bent)[..., None]
        )
        rays -= step[:, :, 0]
    return rays


def _cross(vectors: np.ndarray) -> np.ndarray:
    """[M, 3, 3] with _cross(a) @ b = a x b."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
