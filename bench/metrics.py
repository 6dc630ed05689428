"""One number of a benchmark, and how it compares with the committed one of the same device."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Metric:
    name: str  # unique, such as "rasterize/10k/2 threads"
    value: float
    unit: str
    direction: Literal["lower", "higher"]  # which is better
    tolerance: float  # relative change for the worse that is still no regression

    def change(self, baseline: float) -> float:
        """Relative change against a baseline; positive is worse."""
        ratio = self.value / baseline
        return ratio - 1 if self.direction == "lower" else 1 / ratio - 1

    def regressed(self, baseline: float) -> bool:
        return self.change(baseline) > self.tolerance
