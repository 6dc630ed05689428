"""A corner of two textured walls as photos with exact poses, depths and tracks: what surfaces are looked for in."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.views import Views

WIDTH, HEIGHT, FOCAL = 96, 64, 80.0
WALLS = (  # normal n and offset: n . p = offset
    (np.array([0.5, 0.0, 1.0]), 5.0),
    (np.array([-0.6, 0.0, 1.0]), 5.0),
)


@dataclass(frozen=True)
class TexturedWalls:
    views: Views
    model: Reconstruction
    depths: np.ndarray  # [N, H, W] true camera z


def textured_walls(
    folder: Path,
    *,
    cameras: int = 7,
    is_test: tuple[int, ...] = (0,),
    gains: tuple[float, ...] = (),  # brightness of each photo
    along: tuple[float, ...] = (),  # x of each camera; default: evenly from -1.2 to 1.2
) -> TexturedWalls:
    """Cameras side by side, looking at the corner; 60 points of the walls with their tracks."""
    rng = np.random.default_rng(0)
    waves = rng.normal(0.0, 9.0, (40, 3)), rng.uniform(0.0, 2 * np.pi, 40)
    camera = Camera.pinhole(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2)
    x = np.array(along) if along else np.linspace(-1.2, 1.2, cameras)
    centers = np.stack([x, np.zeros(cameras) if along else 0.1 * np.arange(cameras) % 0.3, np.zeros(cameras)], axis=1)
    turns = np.stack([_about_y(-0.1 * x) for x in centers[:, 0]])
    translations = -np.einsum("nij,nj->ni", turns, centers)
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(camera.K).T
    names, depths = [], []
    for k in range(cameras):
        depth = _depth(centers[k], rays @ turns[k])
        world = centers[k] + depth[..., None] * (rays @ turns[k])
        image = np.stack([_texture(world, waves, shift) for shift in (0.0, 0.4, 0.8)], axis=-1)
        image = np.clip(image * (gains[k] if gains else 1.0), 0, 255).astype(np.uint8)
        names.append(f"{k}.png")
        cv2.imwrite(str(folder / names[k]), image[..., ::-1])
        depths.append(depth)
    picked = rng.integers([0, 0], [HEIGHT, WIDTH], (60, 2))
    middle = cameras // 2
    points = np.array([centers[middle] + depths[middle][r, c] * (rays[r, c] @ turns[middle]) for r, c in picked])
    in_cameras = np.einsum("nij,pj->npi", turns, points) + translations[:, None]
    projected = in_cameras @ camera.K.T
    pixels = projected[..., :2] / projected[..., 2:]
    seen = ((pixels > 0) & (pixels < [WIDTH, HEIGHT])).all(axis=-1)  # [N, P]
    point, image = np.nonzero(seen.T)
    model = Reconstruction(
        cameras=(camera,),
        names=tuple(names),
        camera_ids=np.zeros(cameras, int),
        rotations=turns,
        translations=translations,
        points=points,
        colors=np.full((60, 3), 128, np.uint8),
        errors=np.full(60, 0.5),
        track_offsets=np.r_[0, np.cumsum(seen.sum(axis=0))],
        track_images=image.astype(np.int32),
        track_xy=pixels[image, point],
    )
    views = Views(
        folder=folder,
        names=tuple(names),
        images=tuple(names),
        masks=(None,) * cameras,
        sizes=np.tile([WIDTH, HEIGHT], (cameras, 1)),
        Ks=np.tile(camera.K, (cameras, 1, 1)),
        viewmats=model.viewmats,
        is_test=np.isin(np.arange(cameras), is_test),
    )
    return TexturedWalls(views, model, np.array(depths))


def off_the_walls(
    points: np.ndarray,  # [P, 3]
) -> np.ndarray:
    """[P] distance to the nearer wall."""
    return np.min([np.abs(points @ n - offset) / np.linalg.norm(n) for n, offset in WALLS], axis=0)


def _depth(center: np.ndarray, rays: np.ndarray) -> np.ndarray:
    return np.min([(offset - center @ n) / (rays @ n) for n, offset in WALLS], axis=0)


def _texture(world: np.ndarray, waves, shift: float) -> np.ndarray:
    frequencies, phases = waves
    return 128.0 + 14.0 * np.sin(world @ frequencies.T + phases + shift).sum(axis=-1)


def _about_y(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
