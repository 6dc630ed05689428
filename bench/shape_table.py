"""The scoreboard of shapes as a table: a line per set and program."""

from collections.abc import Iterable
from dataclasses import dataclass

from bench.shape_measures import Measures
from bench.shape_verdict import Status, Verdict

WIDTHS = {
    "set": 18, "by": 7, "placed": 7, "position %": 15, "rotation deg": 15, "focal %": 7, "local scale %": 13,
    "bend, scatter m": 15, "shape": 36, "CPU s": 16,
}  # fmt: skip
COLUMNS = tuple(WIDTHS)
LEGEND = (
    "Position: median / largest, in % of the largest distance between true cameras; rotation: relative, median / 99th "
    "percentile; focal: against the truth; local scale: the stretch of the scene that differs most from the rest; "
    "bend: heights at the rim against the middle, and what scatters about that."
)


@dataclass(frozen=True)
class Row:
    name: str
    by: str  # graphgs or COLMAP
    photos: int
    measures: Measures | None
    status: Status
    verdict: Verdict | None  # None: the truth is too coarse to judge by
    cpu_s: float
    ratio: float | None = None  # COLMAP's seconds by ours, in our row

    def cells(self) -> tuple[str, ...]:
        m = self.measures
        if m is None:
            figures = ("0/" + str(self.photos), *[""] * 5)
        else:
            figures = (
                f"{m.placed}/{m.photos}",
                f"{m.position_median:.3f} / {m.position_largest:.3f}",
                "" if m.rotation_median is None else f"{m.rotation_median:.3f} / {m.rotation_p99:.3f}",
                "" if m.focal is None else f"{m.focal:+.2f}",
                f"{m.local_scale:+.2f}",
                "" if m.bend is None else f"{m.bend:+.2f}, {m.scatter:.2f}",
            )
        seconds = f"{self.cpu_s:.0f}" + ("" if self.ratio is None else f" ({self.ratio:.1f}x less)")
        return (self.name, self.by, *figures, self.shape(), seconds)

    def shape(self) -> str:
        """The verdict in words, or how the run ended where there is none."""
        if self.verdict is None:
            return self.status
        words = [self.verdict.word]
        if self.verdict.defects:
            words.append(f"({', '.join(self.verdict.defects)})")
        if self.verdict.needless:
            words.append("needless caution")
        elif self.verdict.word == "right" and self.status == "caution":
            words.append("cautioned")
        return " ".join(words)


def heading() -> str:
    return line(COLUMNS)


def line(cells: Iterable[str]) -> str:
    return "  ".join(cell.ljust(width) for cell, width in zip(cells, WIDTHS.values(), strict=True)).rstrip()


def markdown(rows: Iterable[Row]) -> str:
    """The table for docs/structure.md."""
    lines = [f"| {' | '.join(COLUMNS)} |", f"|{'---|' * len(COLUMNS)}"]
    lines += [f"| {' | '.join(row.cells())} |" for row in rows]
    return "\n".join(lines) + "\n"
