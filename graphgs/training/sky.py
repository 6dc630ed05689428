"""Gaussians for what no two photos agree on: sky and far background, on a sphere around the scene."""

import dataclasses

import numpy as np

from graphgs.points import PrunedPoints
from graphgs.scene.views import ImageCache, Views

RADIUS = 20.0  # scene extents; and at least twice as far as nearly all points
FAR_QUANTILE = 0.99
CELLS = (16, 9)  # of an image, columns and rows: a cell with an initial point shows no sky
LEAST_EMPTY = 0.5  # share of the views of a direction in which its cell must hold no point
_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


def with_sky(
    points: PrunedPoints,
    views: Views,
    *,
    count: int,  # on the whole sphere
    extent: float,  # scene extent, world
    budget_bytes: int,  # of decoded photos
) -> PrunedPoints:
    """The points and, behind them, those of a far sphere that training views see past all points. Each has the median
    colour of the training photos at its place and the size that closes the sphere. Held-out views decide nothing."""
    training = np.flatnonzero(~views.is_test)
    middle = scene_middle(views)
    far = np.quantile(np.linalg.norm(points.positions - middle, axis=1), FAR_QUANTILE)
    radius = max(RADIUS * extent, 2.0 * float(far))
    sphere = middle + radius * fibonacci_sphere(count)
    seen = np.zeros((len(training), count), dtype=bool)
    empty = np.zeros_like(seen)
    colors = np.full((len(training), count, 3), np.nan, dtype=np.float32)
    cache = ImageCache(views, budget_bytes=budget_bytes)
    for row, i in enumerate(training):
        pixels, seen[row] = _project(views, i, sphere)
        near, inside = _project(views, i, points.positions)
        empty[row, seen[row]] = ~_near_points(pixels[seen[row]], near[inside], views.sizes[i])
        if (wanted := seen[row] & empty[row]).any():
            x, y = pixels[wanted].astype(np.int64).T
            photo, mask = cache.get(int(i))
            shown = photo[y, x].astype(np.float32) / 255.0
            if mask is not None:
                shown[mask[y, x] == 0] = np.nan
            colors[row, wanted] = shown
    known = np.isfinite(colors[..., 0]).any(axis=0)
    kept = known & ((seen & empty).sum(axis=0) >= LEAST_EMPTY * np.maximum(1, seen.sum(axis=0)))
    median = np.nanmedian(colors[:, kept], axis=0) if kept.any() else np.zeros((0, 3), np.float32)
    spacing = radius * np.sqrt(4.0 * np.pi / count)
    return _joined(points, sphere[kept], median, 0.5 * spacing)


def scene_middle(views: Views) -> np.ndarray:  # [3] world
    """Median place of the training cameras."""
    return np.median(views.centers[~views.is_test], axis=0)


def fibonacci_sphere(count: int) -> np.ndarray:  # [count, 3] unit
    """Directions spread evenly."""
    k = np.arange(count)
    z = 1.0 - (2.0 * k + 1.0) / count
    ring = np.sqrt(1.0 - z * z)
    return np.stack([ring * np.cos(k * _GOLDEN_ANGLE), ring * np.sin(k * _GOLDEN_ANGLE), z], axis=1)


def _project(views: Views, i: int, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [P, 2] of points in view i, and which of them [P] lie in front of it and in its image."""
    in_camera = positions @ views.viewmats[i, :3, :3].T + views.viewmats[i, :3, 3]
    in_front = in_camera[:, 2] > 0.0
    homogeneous = in_camera @ views.Ks[i].T
    pixels = homogeneous[:, :2] / np.where(in_front, homogeneous[:, 2], 1.0)[:, None]
    return pixels, in_front & ((pixels >= 0.0) & (pixels < views.sizes[i])).all(axis=1)


def _near_points(pixels: np.ndarray, points: np.ndarray, size: np.ndarray) -> np.ndarray:
    """[P] bool: whether an initial point lies in the cell of a pixel, or in one beside it."""
    columns, rows = CELLS
    occupied = np.zeros((rows + 2, columns + 2), dtype=bool)
    x, y = (points * CELLS / size).astype(np.int64).T
    for dy in range(3):
        for dx in range(3):
            occupied[y + dy, x + dx] = True
    x, y = (pixels * CELLS / size).astype(np.int64).T
    return occupied[y + 1, x + 1]


def _joined(points: PrunedPoints, positions: np.ndarray, colors: np.ndarray, scale: float) -> PrunedPoints:
    own = np.asarray(points.colors)
    if own.dtype == np.uint8:
        colors = np.round(255.0 * colors)
    return dataclasses.replace(
        points,
        positions=np.concatenate([points.positions, positions.astype(points.positions.dtype)]),
        colors=np.concatenate([own, colors.astype(own.dtype)]),
        scales=np.concatenate([points.scales, np.full(len(positions), scale, points.scales.dtype)]),
    )
