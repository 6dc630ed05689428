"""The top of the page: what ran, whether it worked, the key figures, what to worry about."""

import numpy as np

from graphgs.evaluation.report import numbers
from graphgs.evaluation.report.data import ReportData
from graphgs.evaluation.report.html import Markup, element, join

STATUS_WORDS = {"complete": "Complete", "partial": "Partial: not trained", "failed": "Failed"}


def header(data: ReportData) -> Markup:
    words = STATUS_WORDS[data.status]
    if data.status == "partial" and data.tests is not None:
        words = "Partial: some photos left out"
    facts = [fact for fact in (data.created, data.device) if fact]
    return element(
        "header",
        element("p", "GraphGS report", class_="kicker"),
        element("h1", data.title),
        element("p", element("span", words, class_=f"status {data.status}"), " ", " · ".join(facts), class_="facts"),
        element("pre", data.command, class_="command") if data.command else None,
    )


def banner(data: ReportData) -> Markup | None:
    """Cause and next step of a run that did not reach its end."""
    if not (data.cause or data.next_step):
        return None
    return element(
        "div",
        element("p", element("strong", "What happened. "), data.cause) if data.cause else None,
        element("p", element("strong", "What to do. "), data.next_step) if data.next_step else None,
        class_=f"banner {data.status}",
        role="alert",
    )


def key_figures(data: ReportData) -> Markup:
    figures = (figure(data) for figure in (_photos, _pairs, _reprojection, _quality, _splats, _cost))
    tiles = [
        element("div", element("dt", label), element("dd", value, class_="value"), element("dd", note, class_="note"))
        for label, value, note in filter(None, figures)
    ]
    return element("dl", tiles, class_="key four" if len(tiles) == 4 else "key")


def warnings(data: ReportData) -> Markup | None:
    if not data.warnings:
        return None
    items = [element("li", warning) for warning in data.warnings]
    return element("div", element("h3", "Warnings"), element("ul", items), class_="warnings")


def _photos(data: ReportData):
    used, total = len(data.photos_used), len(data.photos_used) + len(data.photos_unused)
    unused = numbers.count(total - used)
    note = "all photos of the input" if used == total else f"{unused} not used, listed below"
    return "Photos used", join(numbers.count(used), element("small", f" of {numbers.count(total)}")), note


def _pairs(data: ReportData):
    if data.pairs is None:
        return None
    share = numbers.percent(data.pairs.candidate, data.pairs.exhaustive)
    note = f"{share} of all {numbers.count(data.pairs.exhaustive)}; {numbers.count(data.pairs.verified)} verified"
    return "Pairs matched", numbers.count(data.pairs.candidate), note


def _reprojection(data: ReportData):
    if data.structure is None or not np.isfinite(data.structure.errors).any():
        return None
    median = float(np.nanmedian(data.structure.errors))
    note = f"median of {numbers.count(len(data.structure.errors))} points"
    return "Reprojection error", join(f"{median:.2f}", element("small", " px")), note


def _quality(data: ReportData):
    if data.tests is None or data.tests.psnr is None:
        return None
    lpips = "not measured" if data.tests.lpips is None else f"{data.tests.lpips:.3f}"
    note = f"SSIM {data.tests.ssim:.3f}, LPIPS {lpips}, {_views(len(data.tests.views))}"
    return "Test PSNR", join(f"{data.tests.psnr:.2f}", element("small", " dB")), note


def _splats(data: ReportData):
    if data.num_splats is None:
        return None
    note = "" if data.steps_executed is None else f"after {numbers.count(data.steps_executed)} steps"
    return "Gaussians", numbers.count(data.num_splats), note


def _cost(data: ReportData):
    if not data.stage_seconds:
        return None
    note = "" if data.peak_rss_bytes is None else f"peak memory {numbers.size(data.peak_rss_bytes)}"
    return "Total time", numbers.seconds(sum(data.stage_seconds.values())), note


def _views(count: int) -> str:
    return "1 test view" if count == 1 else f"{count} test views"
