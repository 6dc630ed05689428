"""Test views beside the truth."""

import numpy as np

from graphgs.evaluation.error_map import ERROR_MAX, color_stops
from graphgs.evaluation.report import numbers
from graphgs.evaluation.report.data import HeldOutFigures, HeldOutView
from graphgs.evaluation.report.html import Markup, element, join, table
from graphgs.evaluation.report.pictures import data_uri

MAX_SHOWN = 12  # views with pictures; every view has its figures in the table
KINDS = ("truth", "render", "error")


def section(tests: HeldOutFigures) -> Markup:
    missing = _missing(tests)
    if not tests.views:
        unplaced = "There is no test view to compare: none of the held-out photos (every 8th, by name) could be placed."
        words = unplaced if tests.missing else "This scene has no held-out photo."
        return join(element("p", words, class_="empty"), missing)
    shown = chosen(tests.views)
    pictures = [(tests.views[k], [data_uri(getattr(tests.views[k], kind)) for kind in KINDS]) for k in shown]
    return join(
        element("p", _introduction(tests, len(shown)), class_="lead"),
        _error_scale(),
        element("div", [_trio(v, trio) for v, trio in pictures], class_=f"views {_layout(pictures)}"),
        _all_figures(tests.views) if len(shown) < len(tests.views) else None,
        missing,
    )


def chosen(views: tuple[HeldOutView, ...]) -> list[int]:
    """Which views get pictures: all, or the worst, the best and evenly spaced ones, in order."""
    if len(views) <= MAX_SHOWN:
        return list(range(len(views)))
    scores = np.array([view.psnr for view in views])
    ends = {int(scores.argmin()), int(scores.argmax())}
    others = [k for k in range(len(views)) if k not in ends]
    spaced = np.linspace(0, len(others) - 1, MAX_SHOWN - len(ends)).round().astype(int)
    return sorted(ends | {others[k] for k in spaced})


def _layout(pictures: list[tuple[HeldOutView, list[tuple[str, int, int] | None]]]) -> str:
    """Upright and panoramic pictures go two views to a row; the panels of a panorama stand below each other."""
    aspects = [picture[1] / picture[2] for _, trio in pictures for picture in trio if picture is not None]
    typical = float(np.median(aspects)) if aspects else 1.5
    return "portrait" if typical < 1 else "panorama" if typical > 2 else "landscape"


def _introduction(tests: HeldOutFigures, shown: int) -> str:
    text = "Photos that training never saw: the photo, the scene rendered from its pose, and their difference. "
    if shown < len(tests.views):
        text += f"{shown} of {len(tests.views)} are shown: the worst, the best and evenly spaced ones. "
    text += "Choose a picture to enlarge it; the arrow keys then flip between photo and rendering."
    if tests.psnr_exposure_fitted is not None:
        right = f"{tests.psnr_exposure_fitted:.2f} dB"
        text += f" With the exposure fitted on the left half of each photo, the right halves reach {right}."
    return text


def _trio(view: HeldOutView, trio: list[tuple[str, int, int] | None]) -> Markup:
    shots = [_shot(view, kind, picture) for kind, picture in zip(KINDS, trio, strict=True)]
    words = element("figcaption", element("b", view.name), element("span", figures(view), class_="num"))
    return element("figure", words, element("div", shots, class_="trio"), class_="view")


def _shot(view: HeldOutView, kind: str, picture: tuple[str, int, int] | None) -> Markup:
    label = {"truth": "photo", "render": "rendering", "error": "error"}[kind]
    if picture is None:
        gap = element("span", "picture not found ", class_="empty")
        return element("div", gap, element("small", label), class_="shot")
    uri, width, height = picture
    image = element("img", src=uri, width=width, height=height, alt=f"{view.name}: {label}")
    return element("button", image, element("small", label), type="button", class_="shot", data_kind=label)


def _error_scale() -> Markup:
    stops = ", ".join(f"rgb({r} {g} {b})" for r, g, b in color_stops(9))
    ramp = element("span", class_="ramp", style=f"background: linear-gradient(to right, {stops})")
    words = "Error: mean over the channels of |rendering − photo|, where white is 1"
    top = f"{ERROR_MAX:.3g} and more"
    return element("p", words, element("span", "0"), ramp, element("span", top), class_="note scale")


def _all_figures(views: tuple[HeldOutView, ...]) -> Markup:
    rows = [(view.name, f"{view.psnr:.2f}", f"{view.ssim:.4f}") for view in views]
    summary = element("summary", f"Figures of all {len(views)} test views")
    return element("details", summary, table(("view", "PSNR, dB", "SSIM"), rows, numeric=(1, 2)))


def _missing(tests: HeldOutFigures) -> Markup | None:
    if not tests.missing:
        return None
    names = ", ".join(tests.missing)
    lead = f"{numbers.count(len(tests.missing))} held out but not placed, so not measured: "
    return element("p", element("strong", lead), names, class_="bad names")


def figures(view: HeldOutView) -> str:
    return f"PSNR {view.psnr:.2f} dB · SSIM {view.ssim:.3f}"
