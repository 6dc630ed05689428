"""Choosing pairs for a million cameras: minutes and gigabytes, so it runs only when asked for by name."""

from bench.metrics import Metric
from bench.pairing import at_size


def run(device: str) -> list[Metric]:
    return at_size("1m", 1_000_000)
