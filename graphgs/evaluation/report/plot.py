"""The frame of a chart: linear or logarithmic scales, axes with ticks and units, as inline SVG."""

import math
from dataclasses import dataclass

from graphgs.evaluation.report import numbers
from graphgs.evaluation.report.html import Markup, element, join

WIDTH, HEIGHT = 480, 270
LEFT, RIGHT, TOP, BOTTOM = 56, 16, 14, 46


@dataclass(frozen=True)
class Scale:
    """Data interval [low, high] onto SVG interval [start, stop]."""

    low: float
    high: float
    start: float
    stop: float
    log: bool = False

    def __call__(self, value: float) -> float:
        if self.log:
            t = math.log(max(value, self.low) / self.low) / math.log(self.high / self.low)
        else:
            t = (value - self.low) / (self.high - self.low)
        return self.start + t * (self.stop - self.start)

    def ticks(self, *, count: int, integer: bool = False) -> list[float]:
        if not self.log:
            return numbers.ticks(self.low, self.high, count=count, integer=integer)
        powers = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        for mantissas in ((1,), (1, 3), (1, 2, 5)):
            found = [m * 10.0**p for p in powers for m in mantissas]
            found = [t for t in found if self.low * 0.999 <= t <= self.high * 1.001]
            if len(found) >= 3:
                break
        return found


def x_scale(low: float, high: float) -> Scale:
    return Scale(low, high if high > low else low + 1.0, LEFT, WIDTH - RIGHT)


def y_scale(low: float, high: float, *, log: bool = False) -> Scale:
    return Scale(low, high if high > low else low + 1.0, HEIGHT - BOTTOM, TOP, log)


def chart(
    x: Scale,
    y: Scale,
    marks: object,
    *,
    x_label: str,
    y_label: str,
    description: str,  # for a screen reader
    integer_x: bool = False,
    integer_y: bool = False,
    tick_shift: float = 0.0,  # 0.5 puts the ticks of whole numbers under the middle of their bars
) -> Markup:
    """Axes, grid and labels around `marks`."""
    grid, labels = [], []
    for value in y.ticks(count=5, integer=integer_y):
        at = round(y(value), 1)
        grid.append(element("line", x1=LEFT, x2=WIDTH - RIGHT, y1=at, y2=at, class_="grid"))
        labels.append(element("text", numbers.short(value), x=LEFT - 8, y=at + 4, class_="tick end"))
    base = HEIGHT - BOTTOM
    for value in x.ticks(count=6, integer=integer_x):
        if value + tick_shift > x.high:
            continue
        at = round(x(value + tick_shift), 1)
        labels.append(element("line", x1=at, x2=at, y1=base, y2=base + 4, class_="axis"))
        labels.append(element("text", numbers.short(value), x=at, y=base + 18, class_="tick middle"))
    middle = (TOP + base) / 2
    return element(
        "svg",
        grid,
        marks,
        element("line", x1=LEFT, x2=WIDTH - RIGHT, y1=base, y2=base, class_="axis"),
        labels,
        element("text", x_label, x=(LEFT + WIDTH - RIGHT) / 2, y=HEIGHT - 8, class_="label middle"),
        element("text", y_label, x=13, y=middle, transform=f"rotate(-90 13 {middle})", class_="label middle"),
        viewBox=f"0 0 {WIDTH} {HEIGHT}",
        role="img",
        aria_label=description,
        class_="chart",
    )


def path(points: list[tuple[float, float]], **attributes: object) -> Markup:
    """A line through SVG points."""
    d = "M" + "L".join(f"{px:.1f} {py:.1f}" for px, py in points)
    return element("path", d=d, **attributes)


def figure(title: str, picture: object, caption: object = None) -> Markup:
    """A titled picture with a caption of one or two lines."""
    note = element("p", caption, class_="note") if caption else None
    return element("figure", element("figcaption", element("h3", title)), join(picture), note)
