"""Choosing pairs: seconds, pairs per camera and memory from 600 to 100,000 cameras, and how well the gate tells.

Each size runs in a process of its own, on a rig of three driving down a jittered straight road: in order of shooting,
and shuffled, where a spanning tree takes the place of the order.
"""

import resource
import subprocess
import sys
import time

import numpy as np

from bench.metrics import Metric
from graphgs.structure.pairing import make_pairs
from graphgs.structure.pairing_config import PairingConfig
from tests.support.camera_tracks import straight_track

SIZES = {"600": 600, "2k": 2_000, "10k": 10_000, "100k": 100_000}
RIG = 3
FOV_DEG, DEPTH_RANGE = 60.0, (0.5, 20.0)


def run(device: str) -> list[Metric]:
    from bench import overlap_gate  # not above: the processes that are measured would load its ray caster too

    metrics = [metric for name, n in SIZES.items() for metric in at_size(name, n)]
    return metrics + overlap_gate.run(device)


def at_size(name: str, n: int) -> list[Metric]:
    metrics = []
    for order in ("ordered", "shuffled"):
        command = [sys.executable, "-m", "bench.pairing", str(n), order]
        printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
        wall, cpu, per_camera, peak_mb = map(float, printed[-4:])
        key = f"pairing/{name}/{order}"
        metrics += [
            Metric(key, wall, "s", "lower", 0.5),
            Metric(f"{key}/cpu", cpu, "s", "lower", 0.25),
            Metric(f"{key}/pairs per camera", per_camera, "", "lower", 0.02),
            Metric(f"{key}/memory", peak_mb, "MB", "lower", 0.1),
        ]
    return metrics


def main(n: int, order: str) -> None:
    rotations, centers = (a[:n] for a in straight_track(-(-n // RIG), seed=0, jitter=0.1))
    ordered = order == "ordered"
    if not ordered:
        shuffled = np.random.default_rng(0).permutation(n)
        rotations, centers = rotations[shuffled], centers[shuffled]
    names = [f"{k:07d}.jpg" for k in range(n)]
    wall, cpu = time.perf_counter(), time.process_time()
    made = make_pairs(
        PairingConfig(), names, rotations, centers,
        fov_deg=FOV_DEG, depth_range=DEPTH_RANGE, ordered=ordered, threads=2,
    )  # fmt: skip
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    print(wall, cpu, len(made.pairs) / n, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
