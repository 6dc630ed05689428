"""Pictures of what the noise experiment stored: `python -m bench.structure_plots CACHE OUT`.

Writes OUT/structure_noise_N.svg for every CACHE/noise_N.json.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path

from graphgs.evaluation.report.html import Markup, element
from graphgs.evaluation.report.plot import HEIGHT, WIDTH, chart, path, x_scale, y_scale

COLORS = {
    "graphgs": "#c1121f",
    "CNNP, octant": "#e09f3e",
    "CNNP, paper-loose": "#7b2cbf",
    "CNNP, paper-strict": "#d07ab8",
    "CNNP alone": "#1d70a2",
    "spatial": "#2a9d8f",
    "frustum boxes": "#6c584c",
    "sequential": "#333333",
    "vocabulary tree": "#777777",
    "exhaustive": "#aaaaaa",
}  # those that look at no pose are grey and dashed
STYLE = """text { font: 11px sans-serif; fill: #333 } .label { font-size: 12px } .middle { text-anchor: middle }
.end { text-anchor: end } .grid { stroke: #e4e4e4 } .axis { stroke: #888 } .line { fill: none; stroke-width: 2 }
.poseless { stroke-dasharray: 5 4; stroke-width: 1.5 } .title { font-size: 13px; font-weight: bold }"""
TOP, LEGEND = 24, 150  # [px] above the charts, right of them
NAMES = {"graphgs": "graphgs (gate)"}


def main(cache: Path, out: Path) -> None:
    for stored in sorted(cache.glob("noise_*.json")):
        rows = json.loads(stored.read_text())
        target = out / f"structure_{stored.stem}.svg"
        target.write_text(picture(rows))
        print(target)


def picture(rows: list[dict]) -> Markup:
    """Cost and accuracy against noise, side by side, one line per selector."""
    photos = rows[0]["photos"]
    panels = [
        ("matching, CPU s", lambda row: row["matching_s"]),
        ("median position error, %", lambda row: row["error"]),
    ]
    drawn = [_panel(rows, label, value) for label, value in panels]
    width, height = len(panels) * WIDTH + LEGEND, HEIGHT + TOP
    places = [element("svg", panel, x=k * WIDTH, y=TOP, width=WIDTH, height=HEIGHT) for k, panel in enumerate(drawn)]
    title = f"{photos} photos: noise on the prior, each selector, the same reconstruction"
    return element(
        "svg",
        element("style", STYLE),
        element("rect", width=width, height=height, fill="#fff"),
        element("text", title, x=56, y=16, class_="title"),
        places,
        element("g", _legend(rows), transform=f"translate({len(panels) * WIDTH} {TOP + 20})"),
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {width} {height}",
        width=width,
        height=height,
    )


def _panel(rows: list[dict], label: str, value: Callable[[dict], float]) -> Markup:
    values = [value(row) for row in rows if value(row) > 0]
    x = x_scale(0.0, 1.001 * max(row["noise"] for row in rows))
    y = y_scale(min(values) * 0.8, max(values) * 1.25, log=True)
    lines = []
    for name, color in COLORS.items():
        points = [(x(row["noise"]), y(value(row))) for row in rows if row["selector"] == name]
        if len(points) == 1:  # no pose, no noise
            points = [(x.start, points[0][1]), (x.stop, points[0][1])]
            lines.append(path(points, class_="line poseless", stroke=color))
        elif points:
            lines.append(path(points, class_="line", stroke=color))
            lines += [element("circle", cx=round(px, 1), cy=round(py, 1), r=3, fill=color) for px, py in points]
    return chart(x, y, lines[::-1], x_label="noise, rad and m", y_label=label, description=label)


def _legend(rows: list[dict]) -> list[Markup]:
    there = {row["selector"] for row in rows}
    marks = []
    for k, name in enumerate(name for name in COLORS if name in there):
        once = sum(row["selector"] == name for row in rows) == 1
        shape = "line poseless" if once else "line"
        marks.append(path([(4, 20 * k), (26, 20 * k)], class_=shape, stroke=COLORS[name]))
        marks.append(element("text", NAMES.get(name, name), x=32, y=20 * k + 4))
    return marks


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
