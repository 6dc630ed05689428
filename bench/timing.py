"""Medians of repeated runs."""

import statistics
import time
from collections.abc import Callable


def median_ms(
    function: Callable[[], object],
    *,
    repeats: int,
    warmup: int = 2,
) -> float:
    for _ in range(warmup):
        function()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - start)
    return 1e3 * statistics.median(seconds)
