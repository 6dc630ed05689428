"""Small plots as SVG, by hand: no plotting library is needed to remake the documents."""

from collections.abc import Sequence
from html import escape

COLORS = ("#3b6ea5", "#c0692b", "#4f8a4c", "#8a5a9e", "#777777", "#b04a4a")
_WIDTH, _HEIGHT, _LEFT, _TOP, _BOTTOM = 560, 250, 52, 30, 44


def lines(
    title: str,
    x_label: str,
    y_label: str,
    series: dict[str, Sequence[tuple[float, float]]],  # (x, y) by name
) -> str:
    """One line with marks per series."""
    points = [point for line in series.values() for point in line]
    x_low, x_high = min(x for x, _ in points), max(x for x, _ in points)
    y_low, y_high = _padded([y for _, y in points])
    plot = _Plot(title, x_label, y_label, (x_low, x_high), (y_low, y_high))
    for value in sorted({x for x, _ in points}):
        plot.text(plot.x(value), _HEIGHT - _BOTTOM + 16, f"{value:g}", "middle")
    for k, (name, line) in enumerate(series.items()):
        color = COLORS[k % len(COLORS)]
        path = " ".join(f"{plot.x(x):.1f},{plot.y(y):.1f}" for x, y in line)
        plot.parts.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="2"/>')
        plot.parts += [f'<circle cx="{plot.x(x):.1f}" cy="{plot.y(y):.1f}" r="3" fill="{color}"/>' for x, y in line]
        plot.legend(k, name, color)
    return plot.svg()


def bars(
    title: str,
    y_label: str,
    values: dict[str, tuple[float, float]],  # (mean, spread) by name
) -> str:
    """One bar per name about zero, a whisker for the spread."""
    ends = [mean + side * spread for mean, spread in values.values() for side in (-1, 1)]
    plot = _Plot(title, "", y_label, (0, len(values)), _padded([*ends, 0.0]), right=10)
    for k, (name, (mean, spread)) in enumerate(values.items()):
        color = COLORS[0] if mean >= 0 else COLORS[1]
        left, right = plot.x(k + 0.25), plot.x(k + 0.75)
        top, low = plot.y(max(mean, 0.0)), plot.y(min(mean, 0.0))
        plot.parts.append(
            f'<rect x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}" height="{low - top:.1f}" fill="{color}"/>'
        )
        middle = (left + right) / 2
        whisker = f'y1="{plot.y(mean - spread):.1f}" y2="{plot.y(mean + spread):.1f}"'
        plot.parts.append(f'<line x1="{middle:.1f}" x2="{middle:.1f}" {whisker} stroke="#222"/>')
        plot.text(middle, _HEIGHT - _BOTTOM + 16, name, "middle")
    zero = plot.y(0.0)
    plot.parts.append(f'<line x1="{_LEFT}" x2="{_WIDTH - 10}" y1="{zero:.1f}" y2="{zero:.1f}" stroke="#222"/>')
    return plot.svg()


class _Plot:
    def __init__(
        self,
        title: str,
        x_label: str,
        y_label: str,
        x: tuple[float, float],
        y: tuple[float, float],
        *,
        right: int = 123,
    ):
        self._x, self._y, self._right = x, y, right  # [px] right of the data, for the legend
        self.parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" '
            f'height="{_HEIGHT}" font-family="sans-serif" font-size="11">',
            f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="white"/>',
        ]
        self.text(_LEFT, 18, f"{title}  [{y_label}]", "start", bold=True)
        self.text((_LEFT + _WIDTH) / 2, _HEIGHT - 8, x_label, "middle")
        for k in range(5):
            value = y[0] + k / 4 * (y[1] - y[0])
            height = self.y(value)
            self.parts.append(
                f'<line x1="{_LEFT}" x2="{_WIDTH - 10}" y1="{height:.1f}" y2="{height:.1f}" stroke="#ddd"/>'
            )
            self.text(_LEFT - 6, height + 4, f"{value:.2f}", "end")

    def x(self, value: float) -> float:
        low, high = self._x
        return _LEFT + 12 + (value - low) / ((high - low) or 1.0) * (_WIDTH - _LEFT - 12 - self._right)

    def y(self, value: float) -> float:
        low, high = self._y
        return _HEIGHT - _BOTTOM - (value - low) / ((high - low) or 1.0) * (_HEIGHT - _TOP - _BOTTOM)

    def text(self, x: float, y: float, words: str, anchor: str, *, bold: bool = False) -> None:
        weight = ' font-weight="bold"' if bold else ""
        self.parts.append(f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{weight}>{escape(words)}</text>')

    def legend(self, row: int, name: str, color: str) -> None:
        y = _TOP + 14 + 15 * row
        self.parts.append(f'<rect x="{_WIDTH - 104}" y="{y - 8}" width="9" height="9" fill="{color}"/>')
        self.text(_WIDTH - 91, y, name, "start")

    def svg(self) -> str:
        return "\n".join([*self.parts, "</svg>"]) + "\n"


def _padded(values: list[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    room = 0.1 * (high - low) or 0.5
    return low - room, high + room
