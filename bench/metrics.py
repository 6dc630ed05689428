"""One number of a benchmark, and how it compares with the committed one of the same device."""

import math
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Metric:
    name: str  # unique, such as "rasterize/10k/2 threads"
    value: float
    unit: str
    direction: Literal["lower", "higher"]  # which is better
    tolerance: float  # relative change for the worse that is still no regression
    yardstick: str = ""  # of a ratio: the hash of what the time is divided by; another makes another metric

    def change(self, baseline: float) -> float:
        """Relative change against a baseline; positive is worse. Leaving 0 for the worse is a change without limit."""
        if self.value == baseline:
            return 0.0
        before, after = (baseline, self.value) if self.direction == "lower" else (self.value, baseline)
        return after / before - 1 if before else math.inf

    def regressed(self, baseline: float) -> bool:
        return self.change(baseline) > self.tolerance
