"""Measurements by case, set and seed, what may be said of their differences, and how numbers are written."""

import math
import statistics
from dataclasses import dataclass

from scipy.special import stdtrit


@dataclass(frozen=True)
class Figure:
    """Mean and spread over seeds (or sets); the spread is the standard deviation, None from a single one."""

    mean: float
    spread: float | None
    count: int

    def text(self, digits: int = 2, *, sign: bool = False) -> str:
        mean = f"{self.mean:+.{digits}f}" if sign else f"{self.mean:.{digits}f}"
        return mean if self.spread is None else f"{mean} ± {self.spread:.{digits}f}"

    @property
    def verdict(self) -> str:
        """Of a difference, larger being better: decided where zero lies outside its 95 % interval (Student's t). Few
        seeds decide little: three need a mean of 2.5 times their spread."""
        if self.spread is None:
            return "one seed"
        reach = float(stdtrit(self.count - 1, 0.975)) * self.spread / math.sqrt(self.count)
        if abs(self.mean) <= reach:
            return "undecided"
        return "gains" if self.mean > 0 else "loses"


def settings_of(rows: list[dict]) -> list[tuple[str, int]]:
    """(device, steps) of the measurements, the last measured first."""
    return list(dict.fromkeys((row["device"], row["base_steps"]) for row in reversed(rows)))


class Table:
    """The measurements of one device and number of steps, by default the last measured; of equal ones the last."""

    def __init__(self, rows: list[dict], setting: tuple[str, int] | None = None):
        self.device, self.steps = settings_of(rows)[0] if setting is None else setting
        self._cells = {
            (row["case"], row["set"], row["seed"]): row
            for row in rows
            if (row["device"], row["base_steps"]) == (self.device, self.steps)
        }

    @property
    def rows(self) -> list[dict]:
        return list(self._cells.values())

    @property
    def sets(self) -> list[str]:
        return sorted(
            {name for _, name, _ in self._cells}, key=lambda name: (name in ("drive", "street", "street-own"), name)
        )

    def seeds(self, case: str, name: str) -> dict[int, dict]:
        return {seed: row for (c, n, seed), row in self._cells.items() if (c, n) == (case, name)}

    def has(self, case: str, name: str) -> bool:
        return bool(self.seeds(case, name))

    def figure(self, case: str, name: str, key: str) -> Figure | None:
        """None where it was not measured."""
        values = [row[key] for row in self.seeds(case, name).values() if row.get(key) is not None]
        return figure_of(values) if values else None

    def difference(
        self,
        case: str,
        against: str,
        name: str,
        key: str = "psnr",
        *,
        relative: bool = False,  # as a share of the other
    ) -> Figure | None:
        """Of the same seed, case minus the other; None where no seed has both."""
        ours, others = self.seeds(case, name), self.seeds(against, name)
        pairs = [(ours[seed].get(key), others[seed].get(key)) for seed in sorted(ours.keys() & others.keys())]
        values = [(a - b) / b if relative else a - b for a, b in pairs if a is not None and b]
        return figure_of(values) if values else None

    def best_of(self, cases: tuple[str, ...], name: str) -> str | None:
        """The case with the highest PSNR of the first seed."""
        scores = {case: rows[0]["psnr"] for case in cases if 0 in (rows := self.seeds(case, name))}
        return max(scores, key=scores.get) if scores else None


def figure_of(values: list[float]) -> Figure:
    spread = statistics.stdev(values) if len(values) > 1 else None
    return Figure(statistics.mean(values), spread, len(values))


def number(figure: Figure | None, digits: int = 2) -> str:
    return "" if figure is None else figure.text(digits)


def count(figure: Figure | None) -> str:
    return "" if figure is None else f"{figure.mean:.0f}"


def signed(figure: Figure | None) -> str:
    return "" if figure is None else figure.text(sign=True)


def percent(figure: Figure | None, *, sign: bool = False) -> str:
    if figure is None:
        return ""
    spread = None if figure.spread is None else 100 * figure.spread
    return Figure(100 * figure.mean, spread, figure.count).text(1 if sign else 2, sign=sign)


def markdown(head: list[str], body: list[list[str]]) -> str:
    rule = "|" + "---|" * len(head)
    return "\n".join([f"| {' | '.join(head)} |", rule, *(f"| {' | '.join(row)} |" for row in body)])
