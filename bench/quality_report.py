"""docs/results.md from the stored measurements: every number and every verdict in it is computed here."""

import re
from collections.abc import Callable
from pathlib import Path

import cv2

from bench import quality_plots as plots
from bench import quality_sections as sections
from bench.quality_cases import BY_NAME
from bench.quality_scenes import JPEG_QUALITY
from bench.quality_table import Figure, Table, count, figure_of, markdown, number, percent, settings_of, signed

PICTURE_QUALITY = 80
PICTURES = ("ahead", "aside")  # held-out views of the synthetic set
SHOWN = {"truth": "truth", "full": "full", "plain": "plain tuned"}  # their pictures, by column
HEADLINE = (
    "full", "plain", "plain tuned", "plain tuned, equal time", "plain, dense points", "full, control's rates",
)  # fmt: skip
GROUPS = {
    "Consistency": (
        "no consistency", "lambda .03", "lambda .15", "target random", "target sampled", "source truth", "source both",
        "consistency paper",
    ),
    "Sampling": (
        "uniform", "sampling paper", "sampling affine", "sampling loss", "importance degree", "full at .6",
        "uniform at .6",
    ),
    "Initial points": ("no dense points", "no depth loss", "all points", "octree .4", "random .4"),
    "Densification": ("mcmc", "signed gradients", "kept opacity"),
    "Floaters, sky, passers-by, speed": (
        "sky sphere", "robust .1", "prune near", "prune unconfirmed", "warm-up .3", "sparse Adam",
    ),
    "Exposures and poses of photos as they came": ("affine exposures", "refined poses"),
}  # fmt: skip

PAPER = {  # what the method's paper (GraphGS, ICLR 2025) prints, on Waymo
    "Consistency": "The paper: 29.42 dB without, 30.36 with (Waymo).",
    "Sampling": "The paper: 28.81 dB after 30,000 steps, 30.36 with 16,830 of them executed; no uniform control.",
    "Initial points": "The paper: 29.74 dB from 245,820 points, 29.75 from 100,000; no random control.",
}

BEFORE_DENSE_POINTS = """
- **Before** there were dense points and a loss of their depth: here, `full` is consistency, sampling by importance and
  the reconstruction's points."""


def write_report(
    rows: list[dict],
    docs: Path,
    *,
    pictures: Path,  # those of SHOWN as VIEW-NAME.png, if they are there
) -> Path:
    """Write docs/results.md and what it shows; returns its path. What was measured on other devices, or with another
    number of steps, has a page of its own beside it."""
    folder = docs / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    first, *others = settings_of(rows)
    pages = {setting: f"results-{_slug(*setting)}.md" for setting in others}
    links = [f"[{device}, {steps} steps]({page})" for (device, steps), page in pages.items()]
    table = Table(rows, first)
    also = f"Also measured: {', '.join(links)}." if links else ""
    _write(
        docs / "results.md", [_introduction(table), also, *_sections(table, folder, ""), _pictures(pictures, folder)]
    )
    for setting, page in pages.items():
        table = Table(rows, setting)
        _write(docs / page, [_introduction(table), *_sections(table, folder, f"-{_slug(*setting)}")])
    return docs / "results.md"


def _sections(table: Table, folder: Path, mark: str) -> list[str]:
    """What a set of measurements can be asked; `mark` tells its plots from others."""
    return [
        _headline(table, folder, mark),
        _ablations(table, folder, mark),
        sections.structure(table),
        sections.octree(table),
        sections.fewer_steps(table),
        sections.sparse(table),
        sections.noise(table, folder, mark),
        sections.poses(table),
        sections.exposure(table),
        sections.passers_by(table),
        sections.rates(table),
    ]


def _write(path: Path, parts: list[str]) -> None:
    path.write_text("\n\n".join(part for part in parts if part) + "\n", encoding="utf-8")


def _slug(device: str, steps: int) -> str:
    return re.sub(r"[^a-z0-9]+", "-", f"{device} {steps}".lower()).strip("-")


def _introduction(table: Table) -> str:
    rows = table.rows
    versions = ", ".join(
        f"{name} {' and '.join(sorted({str(row[name]) for row in rows}))}"
        for name in ("torch", "warp", "python", "commit")
    )
    seeds = max(len(table.seeds("full", name)) for name in table.sets) if table.sets else 0
    jobs = " or ".join(str(n) for n in sorted({row["jobs"] for row in rows}))
    missing = sum(row["missing"] for row in rows if row["case"] == "full" and row["seed"] == 0)
    before = "" if any(row.get("dense_s") for row in rows) else BEFORE_DENSE_POINTS
    return f"""# Quality: what each part gains, and what it does not

Made by `python -m bench.quality --report` from `bench/results/quality.jsonl`; no number is written by hand.
`python -m bench --only quality` measures again.

- **Where**: {table.device}; {versions}. {len(rows)} trainings, {jobs} at a time, so seconds and frames per
  second compare with each other and are not the best a machine can do.
- **How**: {table.steps} executed steps (less where it says so), at most 20,000 Gaussians (the `preview` preset), poses
  from our own structure estimation. `street` has the exact poses, `street-own` the same photos with our own; both are
  synthetic, three cameras on a vehicle, every 4th frame; `drive` is synthetic, one camera, every frame, exact poses.
  Photos are stored as JPEG of quality {JPEG_QUALITY} at the training size. Defaults are those of that commit; why they
  are what they are stands in decisions/0014, 0020, 0024, 0031 and 0032.
- **Judged** on every 8th photo, never trained on; {missing} held-out photos could not be placed and are not in the
  means. PSNR is the mean over held-out views, "worst" its lowest view. Up to {seeds} seeds; ± is the standard deviation
  over them.
- **Differences** compare equal seeds. One *gains* or *loses* only where zero lies outside its 95 % interval (Student's
  t: three seeds need a mean of 2.5 times their spread); otherwise it is *undecided*, and one seed decides
  nothing.{before}"""


def _headline(table: Table, folder: Path, mark: str) -> str:
    columns: list[tuple[str, Callable[[str, str], str]]] = [
        ("PSNR dB", lambda c, n: number(table.figure(c, n, "psnr"))),
        ("SSIM", lambda c, n: number(table.figure(c, n, "ssim"), 3)),
        ("worst dB", lambda c, n: number(table.figure(c, n, "worst"))),
        ("depth error %", lambda c, n: percent(table.figure(c, n, "depth_error"))),
        ("steps", lambda c, n: count(table.figure(c, n, "steps"))),
        ("seconds", lambda c, n: number(table.figure(c, n, "seconds"), 1)),
        ("for dense points", lambda c, n: number(table.figure(c, n, "dense_s"), 1)),
        ("Gaussians", lambda c, n: count(table.figure(c, n, "splats"))),
        ("frames/s", lambda c, n: count(table.figure(c, n, "frames_per_s"))),
    ]
    body = [
        [name, case, *(cell(case, name) for _, cell in columns)]
        for name in table.sets
        for case in HEADLINE
        if table.has(case, name)
    ]
    text = ["## The method beside the same trainer without it", *_explained(HEADLINE), ""]
    text.append(markdown(["set", "case", *(title for title, _ in columns)], body))
    sentences, bars = [], {}
    for name in table.sets:
        for control in ("plain tuned", "plain tuned, equal time", "plain", "plain, dense points"):
            difference = table.difference("full", control, name)
            if difference is None:
                continue
            if control == "plain tuned":
                bars[name] = (difference.mean, difference.spread or 0.0)
            depth = table.difference("full", control, name, "depth_error", relative=True)
            deeper = "" if depth is None else f"; depth error {percent(depth, sign=True)} %"
            sentences.append([name, control, difference.text(sign=True), difference.verdict + deeper])
    if sentences:
        text += ["", "The full method minus each control:", ""]
        text.append(markdown(["set", "control", "PSNR dB", "verdict"], sentences))
    if bars:
        (folder / f"gain{mark}.svg").write_text(plots.bars("full minus tuned control", "dB", bars))
        text += ["", f"![The full method minus the tuned control, per set](pictures/gain{mark}.svg)"]
    return "\n".join(text)


def _ablations(table: Table, folder: Path, mark: str) -> str:
    text = [
        "## One part changed at a time",
        "PSNR of the changed run minus that of `full`, in dB: positive, the change helps. On the synthetic sets also "
        "the change of the depth error in % of it: negative, the change helps.",
    ]
    for group, cases in GROUPS.items():
        cases = [case for case in cases if any(table.difference(case, "full", name) for name in table.sets)]
        if not cases:
            continue
        sets = [name for name in table.sets if any(table.difference(case, "full", name) for case in cases)]
        deep = [name for name in sets if table.figure("full", name, "depth_error")]
        body = []
        for case in cases:
            found = [table.difference(case, "full", name) for name in sets]
            depths = [table.difference(case, "full", name, "depth_error", relative=True) for name in deep]
            cells = [*map(signed, found), *(percent(figure, sign=True) for figure in depths)]
            body.append([case, BY_NAME[case].about, *cells, _summary(found)])
        head = ["case", "what", *sets, *(f"depth error, {name}, %" for name in deep), "PSNR over the sets"]
        text += ["", f"### {group}", PAPER.get(group, ""), "", markdown(head, body)]
    series = {}
    for name in table.sets:
        ladder = ((0.0, "no consistency"), (0.03, "lambda .03"), (0.07, "full"), (0.15, "lambda .15"))
        line = [(x, f.mean) for x, case in ladder if (f := table.difference(case, "full", name)) is not None]
        if len(line) > 2:
            series[name] = line
    if series:
        plot = plots.lines("PSNR against lambda .07", "weight of the consistency loss", "dB", series)
        (folder / f"lambda{mark}.svg").write_text(plot)
        text += ["", f"![PSNR by weight of the consistency loss](pictures/lambda{mark}.svg)"]
    return "\n".join(text)


def _pictures(source: Path, folder: Path) -> str:
    body = []
    for where in PICTURES:
        row = []
        for name, title in SHOWN.items():
            target = folder / f"street-{where}-{name}.jpg"
            if (source / f"{where}-{name}.png").is_file():
                image = cv2.imread(str(source / f"{where}-{name}.png"))
                cv2.imwrite(str(target), image, [cv2.IMWRITE_JPEG_QUALITY, PICTURE_QUALITY])
            if target.is_file():
                row.append(f"![{title}, {where}](pictures/{target.name})")
        body += [row] if len(row) == len(SHOWN) else []
    if not body:
        return ""
    return "\n".join(["## Held-out views of the street", "", markdown(list(SHOWN.values()), body)])


def _explained(cases: tuple[str, ...]) -> list[str]:
    return [f"- `{case}`: {BY_NAME[case].about}" for case in cases]


def _summary(found: list[Figure | None]) -> str:
    """Mean and spread over the sets, each counting once, and how many of them decide by themselves."""
    figures = [figure for figure in found if figure is not None]
    if len(figures) < 2:
        return ""
    over = figure_of([figure.mean for figure in figures])
    verdicts = [figure.verdict for figure in figures]
    alone = [f"{verdicts.count(word)} {word}" for word in ("gains", "loses") if word in verdicts]
    return f"{over.text(sign=True)}, {over.verdict}" + (f" ({', '.join(alone)})" if alone else "")
