"""The bookkeeping of a run: files written, time, photos, settings, versions."""

from collections.abc import Mapping

from graphgs.evaluation.report import numbers
from graphgs.evaluation.report.data import OutputFile, ReportData
from graphgs.evaluation.report.html import Markup, element, join, table


def outputs(files: tuple[OutputFile, ...]) -> Markup:
    rows = [(element("code", file.path), file.what, file.opens_with) for file in files]
    return table(("file", "what it is", "opens with"), rows)


def stages(data: ReportData) -> Markup:
    total = sum(data.stage_seconds.values())
    longest = max(data.stage_seconds.values())
    rows = []
    for name, spent in data.stage_seconds.items():
        width = 100.0 * spent / longest if longest > 0 else 0.0
        bar = element("span", element("span", class_="fill", style=f"width: {width:.1f}%"), class_="track")
        rows.append((name, bar, numbers.seconds(spent), numbers.percent(spent, total)))
    rows.append((element("b", "total"), "", element("b", numbers.seconds(total)), ""))
    peak = data.peak_rss_bytes
    note = "" if peak is None else f"Peak memory, child processes included: {numbers.size(peak)}."
    return join(
        table(("stage", "", "time", "share"), rows, numeric=(2, 3), class_="bars"),
        element("p", note, class_="note") if note else None,
    )


def photos(data: ReportData) -> Markup:
    unused = None
    if data.photos_unused:
        rows = [(element("span", photo.name, class_="bad"), photo.reason) for photo in data.photos_unused]
        unused = join(element("h3", f"Not used ({numbers.count(len(rows))})"), table(("photo", "why"), rows))
    names = [element("li", name) for name in data.photos_used]
    used = element(
        "details",
        element("summary", f"Used ({numbers.count(len(names))})"),
        element("ul", names, class_="list"),
        open=0 < len(names) <= 60,
    )
    return join(unused, used if names else element("p", "No photo was used.", class_="empty"))


def settings(stages_: Mapping[str, Mapping[str, object]]) -> Markup:
    blocks = [
        element("div", element("h3", stage), _options(options), class_="block") for stage, options in stages_.items()
    ]
    return element("div", blocks, class_="settings")


def versions(data: ReportData) -> Markup:
    return element("div", element("div", _options(data.versions), class_="block"), class_="settings")


def _options(options: Mapping[str, object]) -> Markup:
    rows = [element("tr", element("th", name, scope="row"), element("td", _value(v))) for name, v in options.items()]
    return element("table", element("tbody", rows), class_="options")


def _value(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple | list):
        return ", ".join(_value(v) for v in value) or "–"
    return str(value)
