"""Medians of repeated runs, by the clock on the wall and by the processor time of all threads."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import warp as wp

from bench.metrics import Metric

TOLERANCE = 0.25  # relative; what a shared machine moves a median by


@dataclass(frozen=True)
class Timing:
    wall_ms: float
    cpu_ms: float  # of all threads of this process, user and system: the work done, however many threads shared it


def median_time(
    function: Callable[[], object],
    *,
    repeats: int,
    warmup: int = 2,
    device: str = "cpu",  # its queued work is waited for before a clock is read
) -> Timing:
    for _ in range(warmup):
        function()
    wall, cpu = [], []
    for _ in range(repeats):
        _settle(device)
        start, cpu_start = time.perf_counter(), time.process_time()
        function()
        _settle(device)
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - cpu_start)
    return Timing(1e3 * statistics.median(wall), 1e3 * statistics.median(cpu))


def median_ms(
    function: Callable[[], object],
    *,
    repeats: int,
    warmup: int = 2,
    device: str = "cpu",
) -> float:
    """By the clock on the wall."""
    return median_time(function, repeats=repeats, warmup=warmup, device=device).wall_ms


def time_metrics(name: str, timing: Timing, *, tolerance: float = TOLERANCE) -> list[Metric]:
    return [
        Metric(name, timing.wall_ms, "ms", "lower", tolerance),
        Metric(f"{name}/cpu", timing.cpu_ms, "ms", "lower", tolerance),
    ]


def _settle(device: str) -> None:
    if device != "cpu":
        wp.synchronize_device(device)  # every stream of the context, torch's too
