"""Photos of a textured corner of a room, rendered with homographies: a small scene with known cameras."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from graphgs.sources.photos import Photo, Photos

WIDTH, HEIGHT, FOCAL = 320, 240, 260.0


@dataclass(frozen=True)
class CornerScene:
    photos: Photos
    K: np.ndarray  # [3, 3]
    rotations: np.ndarray  # [N, 3, 3] camera-from-world
    centers: np.ndarray  # [N, 3]


def corner_scene(folder: Path, *, count: int = 8, seed: int = 0, prefix: str = "", shift: float = 0.0) -> CornerScene:
    """`count` photos along an arc, looking into the corner of a floor and two walls with random textures. `shift` moves
    every camera to its right, as another one on the same rig."""
    rng = np.random.default_rng(seed)
    walls = [
        # a corner, and the two edges that span the wall
        (np.array([-3.0, -2.5, 5.0]), np.array([6.0, 0, 0]), np.array([0, 4.0, 0])),
        (np.array([-3.0, 1.5, 2.2]), np.array([6.0, 0, 0]), np.array([0, 0, 2.8])),
        (np.array([-3.0, -2.5, 2.2]), np.array([0, 0, 2.8]), np.array([0, 4.0, 0])),
    ]
    textures = [texture(rng) for _ in walls]
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    rotations, centers, photos = [], [], []
    (folder / "photos").mkdir(parents=True, exist_ok=True)
    for k in range(count):
        t = k / max(count - 1, 1) - 0.5
        center = np.array([1.6 * t, 0.25 * np.sin(5 * t), 0.6 * t * t])
        rotation = looking_at(center, np.array([-0.8 + 0.8 * t, 0.0, 4.2]))
        center = center + shift * rotation[0]
        image = _render(walls, textures, K, rotation, center)
        name = f"photos/{k:06d}.png"
        cv2.imwrite(str(folder / name), image)
        photos.append(photo(f"{prefix}{k:02d}.jpg", name))
        rotations.append(rotation)
        centers.append(center)
    return CornerScene(Photos(folder, tuple(photos)), K, np.array(rotations), np.array(centers))


def photo(name: str, pixels: str, *, focal_px: float | None = None, mask: str | None = None) -> Photo:
    return Photo(
        name=name,
        pixels=pixels,
        width=WIDTH,
        height=HEIGHT,
        original_width=WIDTH,
        original_height=HEIGHT,
        mask=mask,
        focal_px=focal_px,
        camera_key="corner",
        sha256=name,
        gps=None,
        time=None,
    )


def texture(rng: np.random.Generator, rows: int = 600, columns: int = 900) -> np.ndarray:
    """[rows, columns, 3] blobs of many sizes."""
    total = np.zeros((rows, columns, 3), np.float32)
    for cells in (12, 30, 75, 150):
        noise = rng.standard_normal((cells * rows // columns, cells, 3)).astype(np.float32)
        total += cv2.resize(noise, (columns, rows), interpolation=cv2.INTER_CUBIC)
    return np.clip(128 + 32 * total, 0, 255).astype(np.uint8)


def looking_at(center: np.ndarray, target: np.ndarray) -> np.ndarray:
    forward = (target - center) / np.linalg.norm(target - center)
    right = np.cross(np.array([0.0, 1.0, 0.0]), forward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def _render(walls, textures, K: np.ndarray, rotation: np.ndarray, center: np.ndarray) -> np.ndarray:
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    # Pixel centres lie at +0.5 here and at integers in OpenCV.
    half = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
    for (origin, u, v), texture in zip(walls, textures, strict=True):
        rows, columns = texture.shape[:2]
        on_wall = np.stack([u / columns, v / rows, origin], 1) @ np.linalg.inv(half)
        to_image = half @ K @ rotation @ (on_wall - np.outer(center, [0, 0, 1]))
        seen = cv2.warpPerspective(np.full((rows, columns), 255, np.uint8), to_image, (WIDTH, HEIGHT))
        warped = cv2.warpPerspective(texture, to_image, (WIDTH, HEIGHT), flags=cv2.INTER_AREA)
        image[seen > 127] = warped[seen > 127]
    return image
