"""The sections of docs/results.md that answer one question each; empty where nothing was measured for it."""

from functools import partial
from pathlib import Path

from bench import quality_plots as plots
from bench.quality_cases import BY_NAME, GRID
from bench.quality_scenes import OCTREE_SHARE
from bench.quality_table import Table, count, markdown, number, percent, signed

STRUCTURE = ("full", "no filter", "no CNNP", "paper's pairs", "no structure estimation")


def structure(table: Table) -> str:
    body = []
    for name in table.sets:
        cases = [case for case in STRUCTURE if table.has(case, name)]
        for case in cases if len(cases) > 1 else []:
            counts = (count(table.figure(case, name, key)) for key in ("photos", "missing", "edges", "points"))
            difference = None if case == "full" else table.difference(case, "full", name)
            verdict = "" if difference is None else f"{difference.text(sign=True)}, {difference.verdict}"
            about = "graphgs pairs and filter, fine poses" if case == "full" else BY_NAME[case].about
            body.append([name, case, about, *counts, number(table.figure(case, name, "psnr")), verdict])
    if not body:
        return ""
    head = ["set", "case", "poses from", "photos", "missing", "verified pairs", "points", "PSNR dB", "minus full"]
    return "\n".join([
        "## Structure estimation taken apart",
        'The same training on other poses; "missing" are held-out photos without a pose. Where pairs and points are '
        "those of `full`, the part taken away had nothing to do on so few photos. The paper: 30.36 dB in full, 29.14 "
        "without the quadrant filter, 24.33 without concentric pairs, 24.77 without structure estimation (Waymo).",
        "",
        markdown(head, body),
    ])  # fmt: skip


def octree(table: Table) -> str:
    """Two comparisons: on reconstructed and dense points, which is the default's case, and on the former alone."""
    text = []
    for names, about in (
        (
            ("joined", "joined, octree", "joined, random"),
            "Reconstructed and dense points together, and room for all of them and more (40,000 Gaussians).",
        ),
        (("filled", "filled, octree", ""), "As many of both as Gaussians are allowed (20,000)."),
        (
            ("all points", "octree .4", "random .4"),
            f"The reconstruction's points alone, {OCTREE_SHARE:.0%} kept; the default prunes no cloud this small.",
        ),
    ):
        body = [row for name in table.sets if (row := _pruned(table, name, *names))]
        if body:
            head = ["set", "points", "all, dB", "octree, dB", "random, dB", "octree, training time, %"]
            text += ["", about, "", markdown(head, body)]
    if not text:
        return ""
    return "\n".join(["## Octree", "Differences to training from all of the points.", *text])


def _pruned(table: Table, name: str, every: str, octree: str, random: str) -> list[str] | None:
    before, after = table.figure(every, name, "points"), table.figure(octree, name, "points")
    if before is None or after is None:
        return None
    differences = [table.difference(case, every, name) if case else None for case in (octree, random)]
    seconds = table.difference(octree, every, name, "seconds", relative=True)
    return [
        name, f"{after.mean:.0f} of {before.mean:.0f} ({after.mean / before.mean:.0%})",
        number(table.figure(every, name, "psnr")), *map(signed, differences), percent(seconds, sign=True),
    ]  # fmt: skip


def fewer_steps(table: Table) -> str:
    body = []
    for name in table.sets:
        cases = ("full", "uniform", "full at .6", "uniform at .6")
        if table.has("full at .6", name):
            difference = table.difference("full at .6", "uniform at .6", name)
            verdict = "" if difference is None else f"{difference.text(sign=True)}, {difference.verdict}"
            body.append([name, *(number(table.figure(case, name, "psnr")) for case in cases), verdict])
    if not body:
        return ""
    head = ["set", "importance", "uniform", "importance, .6", "uniform, .6", "importance minus uniform at .6"]
    return "\n".join(["## Fewer steps", "PSNR in dB with all steps, and with .6 of them.", "", markdown(head, body)])


def sparse(table: Table) -> str:
    body = []
    for name in table.sets:
        for every in (1, 2, 4):
            ours, control = (
                ("full", "plain") if every == 1 else (f"every {every}. photo", f"every {every}. photo, plain")
            )
            difference = table.difference(ours, control, name)
            if difference is None:
                continue
            body.append([
                name, str(every), number(table.figure(ours, name, "psnr")), number(table.figure(control, name, "psnr")),
                difference.text(sign=True), difference.verdict,
            ])  # fmt: skip
    if not any(row[1] != "1" for row in body):
        return ""
    return "\n".join([
        "## Sparse views",
        "Training on every n-th training photo, with poses from all of them; the held-out views stay. The control has "
        "its default rates.",
        "",
        markdown(["set", "n", "full", "plain", "difference", "verdict"], body),
    ])  # fmt: skip


def noise(table: Table, folder: Path, mark: str) -> str:
    ladder = ((0.0, "plain"), (0.1, "noise 0.1"), (0.2, "noise 0.2"), (0.3, "noise 0.3"))
    body, series = [], {}
    for name in table.sets:
        if any(table.has(case, name) for case in ("noise 0.3", "noise 0.3, pipeline")):
            found = [(x, table.figure(case, name, "psnr")) for x, case in ladder]
            pipeline = [number(table.figure(case, name, "psnr")) for case in ("full", "noise 0.3, pipeline")]
            body.append([name, *(number(figure) for _, figure in found), *pipeline])
            line = [(x, figure.mean) for x, figure in found if figure is not None]
            if len(line) > 1:
                series[name] = line
    if not body:
        return ""
    picture = []
    if series:
        plot = plots.lines("plain trainer on noisy poses", "rad and spacings", "dB", series)
        (folder / f"noise{mark}.svg").write_text(plot)
        picture = ["", f"![PSNR of the plain trainer on noisy poses](pictures/noise{mark}.svg)"]
    return "\n".join([
        "## Noisy poses given to the plain trainer",
        "PSNR in dB. Every pose, held-out ones too, is turned by up to so many rad and moved along each axis by up to "
        "so many spacings between cameras. Given to the whole pipeline (`--prior poses=FILE`), such poses choose pairs "
        "only. The paper, with noise of 0.3: 12.68 dB for 3DGS, 28.53 for GraphGS.",
        "",
        markdown(["set", *(f"{x:g}" for x, _ in ladder), "pipeline, none", "pipeline, 0.3"], body),
        *picture,
    ])  # fmt: skip


def poses(table: Table) -> str:
    body = []
    for name in table.sets:
        if not table.has("poses refined", name):
            continue
        get = partial(table.figure, "poses refined", name)
        turn, shift = (get(f"{what}_before{unit}").mean / get(f"{what}_after{unit}").mean
                       for what, unit in (("turn", "_deg"), ("shift", "")))  # fmt: skip
        body.append([
            name, f"{get('turn_before_deg').text(3)} → {get('turn_after_deg').text(3)} (÷ {turn:.1f})",
            f"{percent(get('shift_before'))} → {percent(get('shift_after'))} (÷ {shift:.1f})",
            *(number(table.figure(case, name, "psnr")) for case in ("full", "poses disturbed", "poses refined")),
        ])  # fmt: skip
    if not body:
        return ""
    return "\n".join([
        "## Refining poses",
        "Training poses turned by 0.5 degrees and moved by 1 % of the scene; held-out poses exact. On real photos the "
        "truth is our own structure estimation.",
        "",
        markdown(["set", "turn, degrees", "shift, %", "undisturbed dB", "disturbed dB", "refined dB"], body),
    ])  # fmt: skip


def exposure(table: Table) -> str:
    cases = {
        "full": "constant exposure",
        "exposure disturbed": "disturbed, no model",
        "exposure model": "disturbed, affine model",
    }
    body = _beside_full(table, cases, "exposure disturbed", ("psnr", "psnr_fitted"))
    if not body:
        return ""
    head = ["set", "training photos", "PSNR dB", "right half's PSNR, exposure fitted on the left", "minus constant"]
    return "\n".join([
        "## Exposure",
        "Training photos brighter or darker by up to a stop, each by its own amount; held-out photos as they were.",
        "",
        markdown(head, body),
    ])  # fmt: skip


def passers_by(table: Table) -> str:
    cases = {
        "full": "as they are",
        "passers-by": "with somebody in front",
        "passers-by, robust": "the same, robust loss",
    }
    body = _beside_full(table, cases, "passers-by", ("psnr",))
    if not body:
        return ""
    return "\n".join([
        "## Passers-by",
        "An ellipse, another one in each training photo, covers 8 % of it; held-out photos are as they were. The "
        "robust loss leaves out up to 15 %.",
        "",
        markdown(["set", "training photos", "PSNR dB", "minus without"], body),
    ])  # fmt: skip


def _beside_full(table: Table, cases: dict[str, str], needed: str, keys: tuple[str, ...]) -> list[list[str]]:
    """A row per set and case: what it is, its figures, and what it loses against the full method."""
    body = []
    for name in table.sets:
        for case, about in cases.items():
            if table.has(case, name) and table.has(needed, name):
                lost = "" if case == "full" else signed(table.difference(case, "full", name))
                body.append([name, about, *(number(table.figure(case, name, key)) for key in keys), lost])
    return body


def rates(table: Table) -> str:
    body = []
    for name in table.sets:
        best = table.best_of(GRID, name)
        measured = [case for case in GRID if 0 in table.seeds(case, name)]
        if best is None or len(measured) < 2:
            continue
        means, others = BY_NAME[best].rates
        scores = [table.seeds(case, name)[0]["psnr"] for case in measured]
        default = f"{table.seeds('plain', name)[0]['psnr']:.2f}" if 0 in table.seeds("plain", name) else ""
        body.append([
            name, f"{len(measured)} of {len(GRID)}", f"{means:g} / {others:g}", f"{max(scores):.2f}", default,
            f"{min(scores):.2f}",
        ])  # fmt: skip
    if not body:
        return ""
    return "\n".join([
        "## How the control was tuned",
        "Rates of the centres / all others, as multiples of the defaults: one of the two times 0.7 or 1.4, or both as "
        "they are; the best PSNR on the held-out views with the first seed is taken, which favours the control.",
        "",
        markdown(["set", "runs", "best", "best dB", "default dB", "lowest dB"], body),
    ])  # fmt: skip
