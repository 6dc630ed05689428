"""How the photos were tied together: pairs, the camera graph, the reconstruction's figures and checks."""

import numpy as np

from graphgs.evaluation.report import numbers
from graphgs.evaluation.report.camera_map import camera_map
from graphgs.evaluation.report.charts import histogram
from graphgs.evaluation.report.data import CameraFigures, PairFigures, PhotoGroup, StructureFigures
from graphgs.evaluation.report.html import Markup, element, join, table


def pairs(figures: PairFigures) -> Markup:
    whole = figures.exhaustive
    rows = [
        ("all pairs", numbers.count(whole), numbers.percent(whole, whole)),
        ("candidates, matched", numbers.count(figures.candidate), numbers.percent(figures.candidate, whole)),
        ("verified", numbers.count(figures.verified), numbers.percent(figures.verified, whole)),
    ]
    reasons = [
        (reason, numbers.count(amount), numbers.percent(amount, figures.candidate))
        for reason, amount in figures.kept_because.items()
    ]
    by_reason = [
        element("h3", "Why a candidate was kept"),
        table(("reason", "pairs", "of candidates"), reasons, numeric=(1, 2)),
        element("p", "A pair may have several reasons.", class_="note"),
    ]
    return element(
        "div",
        element(
            "div",
            element("h3", "From all pairs to verified ones"),
            table(("pairs", "count", "of all"), rows, numeric=(1, 2)),
            element("p", f"Chosen by: {figures.selector}.", class_="note") if figures.selector else None,
        ),
        element("div", by_reason) if reasons else None,
        class_="columns",
    )


def cameras(figures: CameraFigures) -> Markup:
    lost = join(_unregistered(figures.unregistered), _groups(figures.groups))
    if not figures.names:
        return join(element("p", "No camera could be placed.", class_="empty"), lost)
    drawn = camera_map(figures)
    tests = int(figures.is_test.sum())
    keys = [
        _key("train", f"training view ({numbers.count(len(figures.names) - tests)})"),
        _key("test", f"test view ({numbers.count(tests)})") if tests else None,
        _key("lost", "not placed, at the camera it shares most with") if _any(figures.beside) else None,
        element("span", element("i", class_="line objection"), "contradicts the poses")
        if figures.objections is not None and len(figures.objections)
        else None,
    ]
    strength = [element("span", element("i", class_=f"line {shade}"), words) for shade, words in drawn.edge_classes]
    size = "" if figures.importance is None else " Larger dots: more of the graph's shortest paths run through them."
    own = " in the reconstruction's own unit, not metres"
    ruler = f"Scale bar: {numbers.short(drawn.bar)}{f' {figures.unit}' if figures.unit else own}."
    note = f"Seen {drawn.seen}. Ticks point along the view.{size} {ruler}"
    return join(
        element(
            "figure",
            element("div", drawn.svg, class_="frame"),
            element("p", keys, class_="legend"),
            element("p", "Verified matches of a pair: ", strength, class_="legend") if strength else None,
            element("p", note, class_="note"),
            class_="wide",
        ),
        lost,
    )


def reconstruction(figures: StructureFigures) -> Markup:
    points = numbers.count(len(figures.errors))
    facts = [("made by", figures.method), ("focal length", figures.focal), ("points", points)]
    listed = [(element("dt", name), element("dd", value)) for name, value in facts if value]
    errors = histogram(
        figures.errors,
        title="Reprojection error of the points",
        x_label="mean reprojection error, px",
        y_label="points",
        unit=" px",
    )
    tracks = histogram(
        figures.track_lengths, title="Track lengths", x_label="photos that see a point", y_label="points", integer=True
    )
    return join(
        element("dl", listed, class_="facts"),
        element("div", errors, tracks, class_="columns"),
        _checks(figures) if figures.checks else None,
    )


def _checks(figures: StructureFigures) -> Markup:
    rows = [
        (check.name, check.value, check.limit, element("span", _verdict(check.passed), class_=_class(check.passed)))
        for check in figures.checks
    ]
    return join(
        element("h3", "Acceptance checks"),
        table(("check", "measured", "limit", "result"), rows),
    )


def _unregistered(names: tuple[str, ...]) -> Markup | None:
    if not names:
        return None
    lead = f"{numbers.count(len(names))} not placed: "
    return element("p", element("strong", lead), ", ".join(names), class_="bad names")


def _groups(groups: tuple[PhotoGroup, ...]) -> Markup | None:
    if not groups:
        return None
    rows = [(group.name, numbers.count(group.count), group.advice or "the one that is kept") for group in groups]
    return join(
        element("h3", "Groups of photos without common features"),
        table(("group", "photos", "what would join it to the kept one"), rows, numeric=(1,)),
    )


def _any(beside: np.ndarray | None) -> bool:
    return beside is not None and bool((beside >= 0).any())


def _key(kind: str, words: str) -> Markup:
    return element("span", element("i", class_=f"dot {kind}"), words)


def _verdict(passed: bool) -> str:
    return "passed" if passed else "failed"


def _class(passed: bool) -> str:
    return "good" if passed else "bad"
