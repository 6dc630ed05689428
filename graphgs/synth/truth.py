"""The true reconstruction of a synthetic set: surface points from its depth images, with the photos that see them."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction

DEPTH_TOLERANCE = 0.01  # relative; a point counts as seen where the depth image agrees
REACH = 24  # shots before and after the one a point was taken from that are asked whether they see it


@dataclass(frozen=True)
class _Taken:
    index: int
    viewmat: np.ndarray
    image: np.ndarray
    depth: np.ndarray


class TruthBuilder:
    """Gathers poses, points and tracks while the photos are taken; holds the images of a few shots only."""

    def __init__(self, camera: Camera, *, points_per_shot: int, seed: int):
        self._camera, self._share, self._seed = camera, points_per_shot, seed
        self._viewmats: list[np.ndarray] = []
        self._window: deque[_Taken] = deque()
        self._sampled = 0
        self._points, self._colors, self._lengths = [], [], []
        self._track_shots, self._track_xy = [], []

    def add(
        self,
        viewmat: np.ndarray,  # [4, 4] world-to-camera
        image: np.ndarray,  # [H, W, 3] uint8
        depth: np.ndarray,  # [H, W] float32, 0 = sky
    ) -> None:
        """The next shot, in the order they are taken."""
        self._window.append(_Taken(len(self._viewmats), viewmat, image, depth))
        self._viewmats.append(viewmat)
        if len(self._viewmats) > self._sampled + REACH:
            self._sample()

    def finish(
        self,
        names: list[str],  # [N] photos in the order they were taken
        camera_ids: list[int],  # [N] of the rig
    ) -> Reconstruction:
        """The truth, images sorted by name, every camera of the rig with intrinsics of its own."""
        while self._sampled < len(self._viewmats):
            self._sample()
        order = sorted(range(len(names)), key=lambda k: names[k])
        rank = np.empty(len(order), np.int32)
        rank[order] = np.arange(len(order))
        viewmats = np.stack(self._viewmats)[order]
        points = np.concatenate(self._points)
        return Reconstruction(
            cameras=(self._camera,) * (max(camera_ids) + 1),
            names=tuple(names[k] for k in order),
            camera_ids=np.array(camera_ids)[order],
            rotations=viewmats[:, :3, :3],
            translations=viewmats[:, :3, 3],
            points=points,
            colors=np.concatenate(self._colors),
            errors=np.zeros(len(points)),
            track_offsets=np.concatenate([[0], np.cumsum(np.concatenate(self._lengths))]).astype(np.int64),
            track_images=rank[np.concatenate(self._track_shots)],
            track_xy=np.concatenate(self._track_xy),
        )

    def _sample(self) -> None:
        """Draw points from the oldest shot not sampled yet, and find them in the shots around it."""
        while self._window[0].index < self._sampled - REACH:
            self._window.popleft()
        shot = next(taken for taken in self._window if taken.index == self._sampled)
        rng = np.random.default_rng([self._seed, 3, shot.index])
        self._sampled += 1

        rows, cols = np.nonzero(shot.depth > 0)
        pick = np.sort(rng.choice(len(rows), min(self._share, len(rows)), replace=False))
        rows, cols = rows[pick], cols[pick]
        fx, fy, cx, cy = self._camera.focal_and_center
        rays = np.column_stack([(cols + 0.5 - cx) / fx, (rows + 0.5 - cy) / fy, np.ones(len(rows))])
        local = rays * shot.depth[rows, cols].astype(float)[:, None]
        world = (local - shot.viewmat[:3, 3]) @ shot.viewmat[:3, :3]

        views = [_visible(world, other.viewmat, self._camera, other.depth) for other in self._window]
        seen = np.stack([view[0] for view in views], axis=1)  # [n, window]
        where = np.stack([view[1] for view in views], axis=1)  # [n, window, 2]
        keep = seen.sum(1) >= 2
        seen, where = seen[keep], where[keep]
        indices = np.array([other.index for other in self._window])
        self._points.append(world[keep])
        self._colors.append(shot.image[rows, cols][keep])
        self._lengths.append(seen.sum(1))
        self._track_shots.append(np.broadcast_to(indices, seen.shape)[seen])
        self._track_xy.append(where[seen])


def _visible(
    world: np.ndarray, viewmat: np.ndarray, camera: Camera, depth: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """([n] bool, [n, 2] px): which points a shot sees, judged by its depth image, and where."""
    fx, fy, cx, cy = camera.focal_and_center
    local = world @ viewmat[:3, :3].T + viewmat[:3, 3]
    z = np.maximum(local[:, 2], 1e-6)
    xy = local[:, :2] / z[:, None] * [fx, fy] + [cx, cy]
    cols, rows = np.floor(np.clip(xy, -1e6, 1e6)).astype(int).T
    inside = (local[:, 2] > 0.1) & (cols >= 0) & (cols < camera.width) & (rows >= 0) & (rows < camera.height)
    surface = depth[np.clip(rows, 0, camera.height - 1), np.clip(cols, 0, camera.width - 1)]
    return inside & (np.abs(surface - z) < DEPTH_TOLERANCE * z), xy
