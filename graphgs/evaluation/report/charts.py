"""The report's charts: a histogram, and a curve whose noise stays visible."""

import numpy as np

from graphgs.evaluation.report import numbers
from graphgs.evaluation.report.html import Markup, element
from graphgs.evaluation.report.plot import chart, figure, path, x_scale, y_scale

BINS = 40
BUCKETS = 120  # points of a drawn curve: one every three or four pixels


def histogram(
    values: np.ndarray,  # [P] non-negative
    *,
    title: str,
    x_label: str,
    y_label: str,
    unit: str = "",
    integer: bool = False,
    last_percentile: float = 99.5,  # what lies above is counted in the last bar, and said
) -> Markup:
    """Bars with the median marked. Values that are not finite are left out, and said."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return figure(title, element("p", "Nothing was measured.", class_="empty"))
    edges = _edges(finite, integer, float(np.percentile(finite, last_percentile)))
    counts, _ = np.histogram(np.minimum(finite, np.nextafter(edges[-1], -np.inf)), edges)
    x, y = x_scale(float(edges[0]), float(edges[-1])), y_scale(0.0, float(counts.max()) * 1.06)
    base = y(0.0)
    beyond = int((finite >= edges[-1]).sum())
    bars = []
    for k, amount in enumerate(counts):
        if not amount:
            continue
        left, right, top = x(edges[k]), x(edges[k + 1]), y(float(amount))
        last = beyond and k == len(counts) - 1
        span = _span(edges[k], edges[k + 1], integer, last)
        bars.append(
            element(
                "rect",
                element("title", f"{span}{unit}: {numbers.count(amount)}"),
                x=round(left + 0.5, 2),
                y=round(top, 2),
                width=round(max(right - left - 1.0, 0.5), 2),
                height=round(base - top, 2),
                class_="bar beyond" if last else "bar",
            )
        )
    median = float(np.median(finite))
    at = round(x(min(median + (0.5 if integer else 0.0), edges[-1])), 1)
    bars.append(element("line", x1=at, x2=at, y1=y.stop, y2=base, class_="marker"))
    caption = f"Median {median:.3g}{unit} (line), mean {finite.mean():.3g}{unit}"
    caption += f", n = {numbers.count(len(finite))}."
    if beyond:
        caption += f" The last, paler bar also counts {numbers.count(beyond)} from {edges[-1]:.3g}{unit} up"
        caption += f" (largest {finite.max():.3g}{unit})."
    if len(finite) < len(values):
        caption += f" {numbers.count(len(values) - len(finite))} without a value are left out."
    picture = chart(
        x,
        y,
        bars,
        x_label=x_label,
        y_label=y_label,
        description=caption,
        integer_x=integer,
        integer_y=True,
        tick_shift=0.5 if integer and edges[1] - edges[0] == 1 else 0.0,
    )
    return figure(title, picture, caption)


def curve(
    steps: np.ndarray,  # [S]
    values: np.ndarray,  # [S]
    *,
    title: str,
    y_label: str,
    band: bool = True,  # show the range of the samples behind their mean
    integer: bool = False,
) -> Markup:
    """The mean of the samples in each bucket of steps, over a band of their range; logarithmic where the values span
    more than a factor of 20."""
    keep = np.isfinite(values)
    dropped = len(values) - int(keep.sum())
    steps, values = np.asarray(steps)[keep], np.asarray(values, dtype=float)[keep]
    if not len(values):
        return figure(title, element("p", "Nothing was recorded.", class_="empty"))
    log = band and values.min() > 0 and values.max() / values.min() > 20
    x = x_scale(0.0, float(steps.max()))
    top = float(values.max())
    y = y_scale(float(values.min()) / 1.1, top * 1.1, log=True) if log else y_scale(0.0, top * 1.06 if top > 0 else 1.0)
    groups = np.array_split(np.arange(len(values)), min(BUCKETS, len(values)))
    middle = [(x(float(steps[g].mean())), y(float(values[g].mean()))) for g in groups]
    marks = []
    if band and len(values) > BUCKETS:
        upper = [(x(float(steps[g].mean())), y(float(values[g].max()))) for g in groups]
        lower = [(x(float(steps[g].mean())), y(float(values[g].min()))) for g in groups]
        marks.append(path(upper + lower[::-1], class_="band"))
    marks.append(path(middle, class_="curve") if len(middle) > 1 else _dot(*middle[0]))
    amount = numbers.short if integer else lambda v: f"{v:.3g}"
    caption = f"First {amount(values[0])}, last {amount(values[-1])}."
    if len(marks) > 1:
        caption = f"Mean over {len(values) // len(groups)} samples (line) and their range (band). " + caption
    if log:
        caption += " Logarithmic axis."
    if dropped:
        caption += f" {numbers.count(dropped)} samples were not finite."
    picture = chart(x, y, marks, x_label="executed steps", y_label=y_label, description=caption, integer_x=True)
    return figure(title, picture, caption)


def _edges(finite: np.ndarray, integer: bool, last: float) -> np.ndarray:
    if integer:
        low, high = int(finite.min()), int(np.ceil(last)) + 1
        step = max(1, -(-(high - low) // BINS))
        return np.arange(low, high + step, step, dtype=float)
    high = last if last > 0 else 1.0
    step = numbers.nice_step(high, count=BINS)
    return np.arange(int(np.ceil(high / step)) + 1) * step


def _span(low: float, high: float, integer: bool, last: bool) -> str:
    if last:
        return f"{low:.4g} or more"
    if integer:
        return f"{low:.0f}" if high - low == 1 else f"{low:.0f} to {high - 1:.0f}"
    return f"{low:.4g} to {high:.4g}"


def _dot(px: float, py: float) -> Markup:
    return element("circle", cx=round(px, 1), cy=round(py, 1), r=3, class_="point")
