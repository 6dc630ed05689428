"""Whether reconstructions have the right shape: ours beside COLMAP as it comes, against the truth.

Real photo sets with a truth, and eighteen synthetic ones of which nine cannot tell their shape: those must come out
right or with a caution that names what is wrong. Seconds are processor seconds of one thread. What was computed once
stays in the cache: COLMAP's results for ever, ours as long as the code is the same.
"""

import argparse
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

from bench.metrics import Metric
from bench.quality_scenes import DATA
from bench.shape_colmap import colmap_result
from bench.shape_measures import measure
from bench.shape_ours import ours_result
from bench.shape_sets import REAL_TRUTHS, ShapeSet, lidar_points, real_set
from bench.shape_synthetic import KINDS, SEEDS, synthetic_set
from bench.shape_table import LEGEND, Row, heading, line, markdown
from bench.shape_verdict import Status, judge
from graphgs.scene.reconstruction import Reconstruction

SETS = (*REAL_TRUTHS, *KINDS)
FEWEST = 3  # photos that can be aligned


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this workload."""
    group = parser.add_argument_group("shape")
    group.add_argument("--sets", nargs="+", choices=SETS, default=SETS, metavar="SET", help=", ".join(SETS))
    group.add_argument("--seeds", nargs="+", type=int, default=SEEDS, help="of the synthetic sets (default: 0 1 2)")
    group.add_argument("--data", type=Path, default=DATA, help="folder of the real photo sets")


def run(device: str, cache: Path, args: argparse.Namespace) -> list[Metric]:
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # so that its children end as well
    rows = []
    print(heading(), flush=True)
    for found in chosen_sets(cache, args):
        for row in rows_of(cache, found):
            print(line(row.cells()), flush=True)
            rows.append((found, row))
    document = cache / "shape.md"
    document.write_text(f"{markdown(row for _, row in rows)}\n{LEGEND}\n\n{summary(rows)}\n")
    print(f"{summary(rows)}\nwrote {document}")
    return [metric for _, row in rows for metric in metrics_of(row)] + totals(rows)


def chosen_sets(cache: Path, args: argparse.Namespace) -> Iterator[ShapeSet]:
    """One after the other, so that a table grows while the next is being made."""
    for name in args.sets:
        if name in KINDS:
            for seed in args.seeds:
                yield synthetic_set(cache, name, seed)
        elif (args.data / name).is_dir():
            yield real_set(args.data, name)
        else:
            print(f"{name}: not in {args.data}, left out", flush=True)


def rows_of(cache: Path, found: ShapeSet) -> tuple[Row, Row]:
    """(ours, COLMAP's)."""
    ours, colmap = ours_result(cache, found), colmap_result(cache, found.name, found.images, found.photos)
    for sentence in (*ours.cautions, ours.message):
        if sentence:
            print(f"{found.name}: {sentence}", flush=True)
    return (
        _row(found, "graphgs", ours.model, ours.status, ours.cautions, ours.cpu_s, ratio=colmap.cpu_s / ours.cpu_s),
        _row(found, "COLMAP", colmap.model, "ok", (), colmap.cpu_s),
    )


def _row(
    found: ShapeSet, by: str, model: Reconstruction | None, status: Status, cautions: tuple[str, ...], cpu_s: float,
    *, ratio: float | None = None,
) -> Row:  # fmt: skip
    measures = None
    if model is not None and len(set(model.names) & set(found.truth.names)) >= FEWEST:
        measures = measure(model, found.truth, lidar=lidar_points(found))
    exact = found.truth.noise_m == 0
    verdict = judge(measures, status, cautions, determined=found.determined) if exact else None
    return Row(found.name, by, len(found.photos), measures, status, verdict, cpu_s, ratio)


def summary(rows: list[tuple[ShapeSet, Row]]) -> str:
    """What the scoreboard counts, in words."""
    lines = []
    for by in ("graphgs", "COLMAP"):
        synthetic = [(found, row) for found, row in rows if row.by == by and found.determined is not None]
        if not synthetic:
            continue
        good = sum(row.verdict.good for _, row in synthetic)
        easy = [row for found, row in synthetic if found.determined]
        needless, right = sum(row.verdict.needless for row in easy), sum(row.verdict.word == "right" for row in easy)
        lines.append(
            f"{by}: right, or cautioned with what is wrong, on {good} of {len(synthetic)} synthetic sets; "
            f"of the {len(easy)} that tell their shape {right} are right and {needless} needlessly cautioned."
        )
    for found, row in rows:
        if row.measures is not None and row.measures.lidar_share is not None:
            lines.append(
                f"{found.name}, {row.by}: {row.measures.lidar_share:.1f} % of the points within .3 m of lidar."
            )
    return "\n".join(lines)


def metrics_of(row: Row) -> list[Metric]:
    key, m = f"shape/{row.name}/{row.by}", row.measures
    if m is None:
        return [Metric(f"{key}/placed", 0, "", "higher", 0.0)]
    metrics = [
        Metric(f"{key}/placed", m.placed, "", "higher", 0.0),
        Metric(f"{key}/position median", m.position_median, "%", "lower", 1.0),
        Metric(f"{key}/local scale", abs(m.local_scale), "%", "lower", 1.0),
        Metric(f"{key}/CPU", row.cpu_s, "s", "lower", 0.5),
    ]
    if m.focal is not None:
        metrics.append(Metric(f"{key}/focal", abs(m.focal), "%", "lower", 1.0))
    if m.bend is not None:
        metrics.append(Metric(f"{key}/bend", abs(m.bend), "m", "lower", 1.0))
    if m.lidar_share is not None:
        metrics.append(Metric(f"{key}/near lidar", m.lidar_share, "%", "higher", 0.1))
    return metrics


def totals(rows: list[tuple[ShapeSet, Row]]) -> list[Metric]:
    ours = [row for found, row in rows if row.by == "graphgs" and found.determined is not None]
    if not ours:
        return []
    return [
        Metric("shape/right or cautioned", sum(row.verdict.good for row in ours), "", "higher", 0.0),
        Metric("shape/needless cautions", sum(row.verdict.needless for row in ours), "", "lower", 0.0),
    ]
