"""Sweeping planes through one photo of 256 x 144 px against four others: what the dense points cost, per photo."""

import cv2
import numpy as np

from bench.metrics import Metric
from bench.timing import median_time, time_metrics
from graphgs.points.plane_sweep import PosedImage, sweep

WIDTH, HEIGHT = 256, 144
PARTNERS = 4
DEPTHS = (2.0, 60.0)  # m; with 0.6 m from photo to photo, all planes that there may be


def run(device: str) -> list[Metric]:
    if device != "cpu":
        print("sweep: it runs on the CPU only")
        return []
    image, *partners = photos()
    timing = median_time(lambda: sweep(image, partners, DEPTHS), repeats=5, warmup=1)
    return time_metrics(f"sweep/{WIDTH}x{HEIGHT}/{PARTNERS} partners", timing)


def photos() -> list[PosedImage]:
    """A wall at 10 m, photographed along a line."""
    rng = np.random.default_rng(0)
    wall = cv2.GaussianBlur(rng.uniform(0, 255, (HEIGHT, 2 * WIDTH)).astype(np.float32), (0, 0), 1.0)
    wall = 128.0 + 3.0 * (wall - wall.mean())
    K = np.array([[200.0, 0.0, WIDTH / 2], [0.0, 200.0, HEIGHT / 2], [0.0, 0.0, 1.0]])
    result = []
    for k in range(PARTNERS + 1):
        viewmat = np.eye(4)
        viewmat[0, 3] = -0.6 * k
        left = 12 * k  # px: 200 px of focal length, 0.6 m aside, 10 m away
        result.append(PosedImage(np.ascontiguousarray(wall[:, left : left + WIDTH]), K, viewmat))
    return result
