"""Pruning 300,000 points by an octree to a third; the same points, warm, since Taichi's compiled kernels are kept."""

import numpy as np

from bench.metrics import Metric
from bench.timing import median_time, time_metrics
from graphgs.points import prune_octree
from graphgs.threads import available_cpus

POINTS, TARGET = 300_000, 100_000


def run(device: str) -> list[Metric]:
    if device != "cpu":
        print("octree: it runs on the CPU only")
        return []
    positions, colors = street()
    timing = median_time(lambda: prune_octree(positions, colors, target=TARGET), repeats=5, warmup=1)
    threads = available_cpus()  # Taichi takes them at its first call
    return time_metrics(f"octree/{POINTS // 1000}k points/{threads} threads", timing)


def street() -> tuple[np.ndarray, np.ndarray]:
    """Points on two walls and a road, in clumps, as a reconstruction leaves them, and some far away."""
    rng = np.random.default_rng(0)
    along = rng.uniform(0, 60, 3000)[rng.integers(0, 3000, POINTS)] + 0.2 * rng.standard_normal(POINTS)
    across, up = rng.uniform(-5, 5, POINTS), rng.uniform(0, 8, POINTS)
    surface = rng.integers(0, 3, POINTS)
    x = np.choose(surface, [np.full(POINTS, -5.0), np.full(POINTS, 5.0), across])
    z = np.where(surface == 2, 0.0, up)
    positions = np.stack([x, along, z], axis=1) + 0.02 * rng.standard_normal((POINTS, 3))
    positions[: POINTS // 100] *= 20
    return positions, rng.integers(0, 256, (POINTS, 3), dtype=np.uint8)
