"""How alike a patch looks in other views if it lies on a plane in front of the camera: pixel by pixel, float64."""

import numpy as np

from graphgs.points.plane_sweep import NOISE, WINDOW, PosedImage


def likeness(image: PosedImage, partners: list[PosedImage], plane: float, row: int, column: int) -> float:
    """Of the patch around a pixel, at camera z = 1 / plane. The patch must lie inside the image."""
    half = WINDOW // 2
    patch = [(r, c) for r in range(row - half, row + half + 1) for c in range(column - half, column + half + 1)]
    own = np.array([float(image.gray[r, c]) for r, c in patch])
    scores = []
    for partner in partners:
        seen = []
        for r, c in patch:
            in_camera = np.linalg.inv(image.K) @ [c + 0.5, r + 0.5, 1.0] / plane
            world = np.linalg.inv(image.viewmat) @ [*in_camera, 1.0]
            x, y, z = partner.K @ (partner.viewmat @ world)[:3]
            if z <= 0:
                return -1.0
            seen.append(_bilinear(partner.gray, x / z - 0.5, y / z - 0.5))
        scores.append(_correlation(own, np.array(seen)))
    return float(np.mean(sorted(scores)[-2:]))


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    covariance = (a * b).mean() - a.mean() * b.mean()
    return covariance / np.sqrt((a.var() + NOISE**2) * (b.var() + NOISE**2))


def _bilinear(gray: np.ndarray, x: float, y: float) -> float:
    """At OpenCV's coordinates, 0 outside."""
    x0, y0 = int(np.floor(x)), int(np.floor(y))
    total = 0.0
    for r, c, share in (
        (y0, x0, (1 - x + x0) * (1 - y + y0)),
        (y0, x0 + 1, (x - x0) * (1 - y + y0)),
        (y0 + 1, x0, (1 - x + x0) * (y - y0)),
        (y0 + 1, x0 + 1, (x - x0) * (y - y0)),
    ):
        if 0 <= r < gray.shape[0] and 0 <= c < gray.shape[1]:
            total += share * float(gray[r, c])
    return total
