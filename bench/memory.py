"""Peak memory of rendering forward and backward, per Gaussian and per pixel, and whether it grows over many steps.

Every figure is taken in a process of its own: a process never gives back what it once had.
"""

import resource
import subprocess
import sys

from bench import threads
from bench.metrics import Metric
from bench.rasterize import Work
from bench.scenes import procedural
from graphgs.rendering import rasterize

MIB = 2**20
STEPS = 5_000


def run(device: str) -> list[Metric]:
    if device != "cpu":
        print("memory: measured on the CPU only")
        return []
    few, many = peak_mb(100_000, 640, 360), peak_mb(500_000, 640, 360)
    small, large = few, peak_mb(100_000, 1920, 1080)
    half, whole = peaks_mb(2_000, 96, 64, steps=STEPS)
    return [
        Metric("memory/per Gaussian", (many - few) * MIB / 400_000, "B", "lower", 0.1),
        Metric("memory/per pixel", (large - small) * MIB / (1920 * 1080 - 640 * 360), "B", "lower", 0.1),
        Metric("memory/1m Gaussians at 1920 x 1080", peak_mb(1_000_000, 1920, 1080), "MB", "lower", 0.1),
        # Kept above 0, where a relative change means something.
        Metric(f"memory/growth from {STEPS // 2} to {STEPS} steps", max(0.1, whole - half), "MB", "lower", 9.0),
    ]


def peak_mb(gaussians: int, width: int, height: int) -> float:
    """Largest resident size of a process that renders twice, forward and backward."""
    return peaks_mb(gaussians, width, height, steps=2)[1]


def peaks_mb(gaussians: int, width: int, height: int, *, steps: int) -> tuple[float, float]:
    """The same after half of the steps and after all."""
    command = [sys.executable, "-m", "bench.memory", *map(str, (gaussians, width, height, steps))]
    half, whole = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()[-2:]
    return float(half), float(whole)


def main(gaussians: int, width: int, height: int, steps: int) -> None:
    work = Work.on("cpu", procedural(gaussians, width, height, pixels=2.0))
    with threads.use_threads(2):
        for step in range(1, steps + 1):
            work.step(rasterize)
            if step in (steps // 2, steps):
                print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
