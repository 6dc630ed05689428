"""The true reconstruction of a synthetic set: surface points from its depth images, with the photos that see them."""

import numpy as np

from graphgs.scene.reconstruction import Reconstruction

DEPTH_TOLERANCE = 0.01  # relative; a point counts as seen where the depth image agrees
REACH = 12  # shots before and after the one a point was taken from that are asked whether they see it


def sample_points(
    names: tuple[str, ...],
    camera_ids: np.ndarray,  # [N] int
    cameras: tuple,
    viewmats: np.ndarray,  # [N, 4, 4] world-to-camera
    images: list[np.ndarray],  # N of [H, W, 3] uint8
    depths: list[np.ndarray],  # N of [H, W] float32, 0 = sky
    *,
    count: int,
    seed: int,
) -> Reconstruction:
    """The true reconstruction, with about `count` surface points drawn from all depth images and their exact tracks."""
    rng = np.random.default_rng([seed, 3])
    shots = len(names)
    share = -(-count // shots)
    points, colors, track_images, track_xy, lengths = [], [], [], [], []
    for i in range(shots):
        rows, cols = np.nonzero(depths[i] > 0)
        pick = np.sort(rng.choice(len(rows), min(share, len(rows)), replace=False))
        rows, cols = rows[pick], cols[pick]
        K, depth = cameras[camera_ids[i]].K, depths[i][rows, cols].astype(float)
        rays = np.column_stack([(cols + 0.5 - K[0, 2]) / K[0, 0], (rows + 0.5 - K[1, 2]) / K[1, 1], np.ones(len(rows))])
        world = (rays * depth[:, None] - viewmats[i, :3, 3]) @ viewmats[i, :3, :3]
        near = range(max(0, i - REACH), min(shots, i + REACH + 1))
        seen, where = zip(*(_visible(world, viewmats[j], cameras[camera_ids[j]], depths[j]) for j in near), strict=True)
        seen, where = np.stack(seen, axis=1), np.stack(where, axis=1)  # [n, near], [n, near, 2]
        keep = seen.sum(1) >= 2
        points.append(world[keep])
        colors.append(images[i][rows, cols][keep])
        lengths.append(seen[keep].sum(1))
        track_images.append(np.broadcast_to(np.arange(near.start, near.stop), seen.shape)[keep][seen[keep]])
        track_xy.append(where[keep][seen[keep]])
    points = np.concatenate(points)
    return Reconstruction(
        cameras=cameras,
        names=names,
        camera_ids=camera_ids,
        rotations=viewmats[:, :3, :3],
        translations=viewmats[:, :3, 3],
        points=points,
        colors=np.concatenate(colors),
        errors=np.zeros(len(points)),
        track_offsets=np.concatenate([[0], np.cumsum(np.concatenate(lengths))]).astype(np.int64),
        track_images=np.concatenate(track_images).astype(np.int32),
        track_xy=np.concatenate(track_xy),
    )


def _visible(world: np.ndarray, viewmat: np.ndarray, camera, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """([n] bool, [n, 2] px): which points a shot sees, judged by its depth image, and where."""
    local = world @ viewmat[:3, :3].T + viewmat[:3, 3]
    z = np.maximum(local[:, 2], 1e-6)
    xy = local[:, :2] / z[:, None] * camera.K[[0, 1], [0, 1]] + camera.K[:2, 2]
    cols, rows = np.floor(xy).astype(int).T
    inside = (local[:, 2] > 0.1) & (cols >= 0) & (cols < camera.width) & (rows >= 0) & (rows < camera.height)
    surface = depth[np.clip(rows, 0, camera.height - 1), np.clip(cols, 0, camera.width - 1)]
    return inside & (np.abs(surface - z) < DEPTH_TOLERANCE * z), xy
