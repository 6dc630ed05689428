"""Camera set-ups to experiment on: where cameras stand and look, no images. World axes as in KITTI: x right, y down,
z ahead; lengths in metres."""

import numpy as np
from scipy.spatial.transform import Rotation


def look(directions: np.ndarray, down: tuple[float, float, float] = (0.0, 1.0, 0.0)) -> np.ndarray:
    """[N, 3, 3] camera-from-world rotations for viewing directions [N, 3]; image y points as far `down` as it can."""
    z = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    x = np.cross(np.broadcast_to(down, z.shape), z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=1)


def heading(yaw: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(yaw), np.zeros_like(yaw), np.cos(yaw)], axis=1)


def random_rotations(n: int, seed: int) -> np.ndarray:
    return Rotation.from_quat(np.random.default_rng(seed).normal(size=(n, 4))).as_matrix()


def random_box(n: int = 200, size: float = 20.0, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    return random_rotations(n, seed), np.random.default_rng(seed + 1).uniform(0, size, (n, 3))


def rig_track(
    centers: np.ndarray,  # [T, 3]
    yaw: np.ndarray,  # [T] heading, rad
    rig_yaw: tuple[float, ...] = (0.0, np.pi / 4, -np.pi / 4),
    seed: int | None = None,
    jitter: float = 0.0,
    arm: float = 0.2,  # cameras sit this far out in their own direction
) -> tuple[np.ndarray, np.ndarray]:
    """A rig of cameras that drives along a track, frame by frame."""
    direction = heading((yaw[:, None] + np.asarray(rig_yaw)).ravel())
    position = np.repeat(centers, len(rig_yaw), axis=0) + arm * direction
    if seed is not None:
        position = position + np.random.default_rng(seed).normal(0, jitter, position.shape)
    return look(direction), position


def straight_track(frames: int = 67, **kwargs) -> tuple[np.ndarray, np.ndarray]:
    s = np.arange(frames, dtype=float)
    return rig_track(np.stack([0 * s, 0 * s, s], 1), 0 * s, **kwargs)


def curve_track(frames: int = 67, **kwargs) -> tuple[np.ndarray, np.ndarray]:
    yaw = np.linspace(0, np.pi / 2, frames)
    radius = (frames - 1) / (np.pi / 2)
    centers = radius * np.stack([1 - np.cos(yaw), 0 * yaw, np.sin(yaw)], 1)
    return rig_track(centers, yaw, **kwargs)


def loop_track(frames: int = 67, **kwargs) -> tuple[np.ndarray, np.ndarray]:
    yaw = np.arange(frames) * 2 * np.pi / frames
    radius = frames / (2 * np.pi)
    centers = radius * np.stack([-np.cos(yaw), 0 * yaw, np.sin(yaw)], 1)
    return rig_track(centers, yaw, **kwargs)


def nadir_grid(side: int = 12, spacing: float = 3.0, height: float = 10.0) -> tuple[np.ndarray, np.ndarray]:
    """A drone that looks straight down from `height` above the ground plane y = 0."""
    z, x = np.meshgrid(np.arange(side) * spacing, np.arange(side) * spacing, indexing="ij")
    centers = np.stack([x.ravel(), np.full(side * side, -height), z.ravel()], 1)
    return look(np.tile([0.0, 1.0, 0.0], (side * side, 1)), down=(0.0, 0.0, -1.0)), centers


def moved(
    rotations: np.ndarray, centers: np.ndarray, *, scale: float = 3.7, seed: int = 5
) -> tuple[np.ndarray, np.ndarray]:
    """The same cameras in another world: scaled, turned, shifted."""
    turn = random_rotations(1, seed)[0]
    shift = np.random.default_rng(seed).uniform(-50, 50, 3)
    return rotations @ turn.T, scale * centers @ turn.T + shift


def noisy(
    rotations: np.ndarray, centers: np.ndarray, *, angle: float, offset: float, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """The cameras turned about random axes by up to `angle` rad and shifted by up to `offset` along each axis."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=(len(centers), 3))
    axis *= rng.uniform(0, angle, (len(centers), 1)) / np.linalg.norm(axis, axis=1, keepdims=True)
    turned = Rotation.from_rotvec(axis).as_matrix() @ rotations
    return turned, centers + rng.uniform(-offset, offset, centers.shape)
