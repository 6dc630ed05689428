"""Puts the sections together and writes the page: one file, nothing fetched from anywhere."""

import os
from importlib.resources import files
from pathlib import Path

from graphgs.evaluation.report import facts, held_out, structure, summary
from graphgs.evaluation.report.charts import curve
from graphgs.evaluation.report.data import ReportData, TrainingCurve
from graphgs.evaluation.report.html import Markup, element, join

# The page may show its own pictures and run its own script; it can load nothing.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


def write_report(path: Path, data: ReportData) -> None:
    """Write report.html, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    partial.write_text(render_page(data), encoding="utf-8", errors="replace")
    os.replace(partial, path)


def render_page(data: ReportData) -> Markup:
    sections = list(_sections(data))
    contents = [element("a", title, href=f"#{key}") for key, title, _ in sections]
    body = element(
        "main",
        summary.header(data),
        summary.banner(data),
        summary.key_figures(data),
        summary.warnings(data),
        element("nav", contents, aria_label="Sections"),
        [element("section", element("h2", title), content, id=key) for key, title, content in sections],
        element("footer", "Written by GraphGS. This page is one file: it loads nothing and can be sent as it is."),
    )
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("meta", http_equiv="Content-Security-Policy", content=POLICY),
        element("title", f"{data.title} – GraphGS report"),
        element("style", _asset("style.css")),
    )
    script = element("script", _asset("page.js"))
    return join(Markup("<!doctype html>\n"), element("html", head, element("body", body, script), lang="en"))


def _sections(data: ReportData):
    """(anchor, title, content) of every section there is something to say in."""
    if data.tests is not None:
        yield "test-views", "Test views", held_out.section(data.tests)
    if data.cameras is not None:
        yield "cameras", "Camera graph", structure.cameras(data.cameras)
    if data.structure is not None:
        yield "reconstruction", "Reconstruction", structure.reconstruction(data.structure)
    if data.pairs is not None:
        yield "pairs", "Pairs", structure.pairs(data.pairs)
    if data.training is not None:
        yield "training", "Training", _training(data.training)
    if data.outputs:
        yield "files", "Files", facts.outputs(data.outputs)
    if data.stage_seconds:
        yield "time", "Time and memory", facts.stages(data)
    yield "photos", "Photos", facts.photos(data)
    if data.settings:
        yield "settings", "Settings", facts.settings(data.settings)
    if data.versions:
        yield "versions", "Versions", facts.versions(data)


def _training(figures: TrainingCurve) -> Markup:
    loss = curve(figures.steps, figures.loss, title="Loss", y_label="training loss")
    splats = curve(figures.steps, figures.num_splats, title="Gaussians", y_label="Gaussians", band=False, integer=True)
    return element("div", loss, splats, class_="columns")


def _asset(name: str) -> Markup:
    return Markup(files(__package__).joinpath(name).read_text(encoding="utf-8"))
