"""Photo sets that invite wrong reconstructions, rendered small, with the truth: repeated houses, turns on the spot,
planes, mixtures, mirrored photos. World axes: x right, y down, z ahead."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from graphgs.sources.photos import Photos
from tests.support.corner_scene import FOCAL, HEIGHT, WIDTH, corner_scene, looking_at, photo, texture

K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
SKY = 200


@dataclass(frozen=True)
class Wall:
    """A textured rectangle: a corner, and the two edges that span it."""

    origin: np.ndarray  # [3]
    u: np.ndarray  # [3] along the texture's columns
    v: np.ndarray  # [3] along its rows
    texture: np.ndarray  # [H, W, 3] uint8

    def shifted(self, by: np.ndarray) -> "Wall":
        return Wall(self.origin + by, self.u, self.v, self.texture)

    def turned(self, rotation: np.ndarray) -> "Wall":
        return Wall(rotation @ self.origin, rotation @ self.u, rotation @ self.v, self.texture)


@dataclass(frozen=True)
class Shots:
    """Rendered photos and where they were taken."""

    images: tuple[np.ndarray, ...]  # [HEIGHT, WIDTH, 3] uint8
    centers: np.ndarray  # [N, 3]
    rotations: np.ndarray  # [N, 3, 3] camera-from-world

    def __add__(self, other: "Shots") -> "Shots":
        poses = [np.concatenate(parts) for parts in zip(self._poses, other._poses, strict=True)]
        return Shots(self.images + other.images, *poses)

    def of(self, chosen: np.ndarray) -> "Shots":
        """Some of them, in that order."""
        return Shots(tuple(self.images[k] for k in chosen), *(part[chosen] for part in self._poses))

    @property
    def _poses(self) -> tuple[np.ndarray, np.ndarray]:
        return self.centers, self.rotations


def as_photos(folder: Path, images: Iterable[np.ndarray], *, focal_px: float | None = None) -> Photos:
    """The photos stage's artefact: 00.jpg, 01.jpg, ... in the order given."""
    (folder / "photos").mkdir(parents=True, exist_ok=True)
    photos = []
    for k, image in enumerate(images):
        pixels = f"photos/{k:06d}.png"
        cv2.imwrite(str(folder / pixels), image)
        photos.append(photo(f"{k:02d}.jpg", pixels, focal_px=focal_px))
    return Photos(folder, tuple(photos))


def shoot(walls: list[Wall], poses: Iterable[tuple[np.ndarray, np.ndarray]]) -> Shots:
    """Photos from (centre, what to look at)."""
    images, centers, rotations = [], [], []
    for center, target in poses:
        rotations.append(looking_at(center, target))
        centers.append(center)
        images.append(render(walls, rotations[-1], center))
    return Shots(tuple(images), np.array(centers), np.array(rotations))


def render(walls: list[Wall], rotation: np.ndarray, center: np.ndarray) -> np.ndarray:
    """[HEIGHT, WIDTH, 3] uint8: the nearest wall in every pixel."""
    image, nearest = np.full((HEIGHT, WIDTH, 3), SKY, np.uint8), np.full((HEIGHT, WIDTH), np.inf)
    half = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])  # pixel centres: +0.5 here, integers in OpenCV
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(K).T @ rotation
    for wall in walls:
        rows, columns = wall.texture.shape[:2]
        normal = np.cross(wall.u, wall.v)
        on_wall = np.stack([wall.u / columns, wall.v / rows, wall.origin - center], axis=1) @ np.linalg.inv(half)
        to_image = half @ K @ rotation @ on_wall
        if abs(np.linalg.det(to_image)) < 1e-12:  # seen edge on
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = normal @ (wall.origin - center) / (rays @ normal)
        inside = cv2.warpPerspective(np.full((rows, columns), 255, np.uint8), to_image, (WIDTH, HEIGHT)) > 127
        seen = inside & (depth > 0.05) & (depth < nearest)
        image[seen] = cv2.warpPerspective(wall.texture, to_image, (WIDTH, HEIGHT))[seen]
        nearest[seen] = depth[seen]
    return image


def house_row(*, houses: int = 2, width: float = 6.0, gap: float = 6.0, count: int = 20, seed: int = 0) -> Shots:
    """A walk along identical houses, each a front with bays, with something of its own in the gaps between."""
    rng = np.random.default_rng(seed)
    house = [_upright(rng, 0.0, width, 6.0, (-2.0, 4.0))]
    for x in np.arange(1.0, width - 1.5, 2.7):
        house += _bay(rng, x, depth=rng.uniform(0.6, 1.3))
    walls, x = [], 0.0
    for k in range(houses):
        walls += [wall.shifted(np.array([x, 0, 0])) for wall in house]
        x += width
        if gap and k < houses - 1:
            walls.append(_upright(rng, x, gap, 7.5, (-2.0, 4.0)))
            walls.append(_upright(rng, x + gap / 2 - 0.5, 1.0, 6.0, (-1.0, 2.0)))
            x += gap
    t = np.linspace(0, 1, count)
    centers = np.stack([2 + (x - 4) * t, 0.3 * np.sin(9 * t), 0.5 * np.sin(5 * t)], axis=1)
    ahead = np.stack([0.4 * np.sin(7 * t), 0.1 * np.cos(4 * t), np.full(count, 5.0)], axis=1)
    return shoot(walls, zip(centers, centers + ahead, strict=True))


def twin_fronts(*, count: int = 48, seed: int = 0) -> Shots:
    """A walk around a house whose front and back are alike, while its sides are not."""
    rng = np.random.default_rng(seed)
    front = [
        _upright(rng, -2.0, 4.0, -1.0, (-1.5, 3.0)),
        *(w.shifted(np.array([-0.6, 0, -7.0])) for w in _bay(rng, 0.0, 0.6)),
    ]
    sides = [
        Wall(np.array([2, -1.5, -1.0]), np.array([0, 0, 2.0]), np.array([0, 3.0, 0]), texture(rng, 300, 200)),
        Wall(np.array([-2, -1.5, 1.0]), np.array([0, 0, -2.0]), np.array([0, 3.0, 0]), texture(rng, 300, 200)),
    ]
    walls = front + [wall.turned(np.diag([-1.0, 1, -1])) for wall in front] + sides
    angle = 2 * np.pi * np.arange(count) / count
    centers = np.stack([5.5 * np.sin(angle), -0.4 + 0.3 * np.sin(3 * angle), -5.5 * np.cos(angle)], axis=1)
    return shoot(walls, ((center, np.zeros(3)) for center in centers))


def turn_on_the_spot(*, count: int = 10, arc_deg: float = 54.0, seed: int = 0) -> Shots:
    """A camera on a tripod in a room."""
    rng = np.random.default_rng(seed)
    walls = []
    for angle in np.radians([0, 90, 180, 270]):
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        walls.append(_upright(rng, -6.0, 12.0, 6.0, (-3.0, 6.0)).turned(turn))
    angle = np.radians(arc_deg) * np.linspace(0, 1, count)
    ahead = np.stack([np.sin(angle), 0.1 * np.sin(9 * angle), np.cos(angle)], axis=1)
    return shoot(walls, ((np.zeros(3), target) for target in ahead))


def one_plane(*, count: int = 12, tilt: float = 0.0, seed: int = 0) -> Shots:
    """A picture on a wall, from a walk along it; `tilt` 0: always square to it, 1: from all sides."""
    rng = np.random.default_rng(seed)
    walls = [Wall(np.array([-6, -4.5, 5.0]), np.array([12.0, 0, 0]), np.array([0, 9.0, 0]), texture(rng, 675, 900))]
    t = np.linspace(-0.5, 0.5, count)
    centers = np.stack([4 * t, 0.6 * np.sin(8 * t), tilt * np.cos(5 * t) - 0.5], axis=1)
    targets = np.stack([4 * t * (1 - 0.8 * tilt), 0.6 * (1 - tilt) * np.sin(8 * t), np.full(count, 5.0)], axis=1)
    return shoot(walls, zip(centers, targets, strict=True))


def corner(folder: Path, *, count: int = 8, seed: int = 0) -> Shots:
    """The corner of a room, an easy scene."""
    scene = corner_scene(folder, count=count, seed=seed)
    images = tuple(cv2.imread(str(folder / photo.pixels)) for photo in scene.photos.photos)
    return Shots(images, scene.centers, scene.rotations)


def unrelated(count: int, *, seed: int = 5) -> tuple[np.ndarray, ...]:
    """Photos of nothing that is seen elsewhere."""
    rng = np.random.default_rng(seed)
    return tuple(texture(rng, HEIGHT, WIDTH) for _ in range(count))


def _upright(rng, x: float, width: float, z: float, span: tuple[float, float]) -> Wall:
    """A wall across the view, 100 texels per unit."""
    top, height = span
    pixels = texture(rng, round(100 * height), round(100 * width))
    return Wall(np.array([x, top, z]), np.array([width, 0, 0]), np.array([0, height, 0]), pixels)


def _bay(rng, x: float, depth: float) -> list[Wall]:
    """A box 1.2 wide and 2 high that stands out of a front at z = 6."""
    flank = (0.0, 2.0, 0.0)
    return [
        _upright(rng, x, 1.2, 6.0 - depth, (-0.5, 2.0)),
        Wall(np.array([x, -0.5, 6.0]), np.array([0, 0, -depth]), np.array(flank), texture(rng, 200, 100)),
        Wall(np.array([x + 1.2, -0.5, 6.0 - depth]), np.array([0, 0, depth]), np.array(flank), texture(rng, 200, 100)),
    ]
