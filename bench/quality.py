"""How good scenes are: the method, its parts taken away one by one, and the controls beside it.

    python -m bench --only quality [--sets ...] [--cases ...] [--seeds 3] [--jobs N] [--minutes M] [--steps 2000]
    python -m bench.quality ...          the same, and --prepare (make the inputs), --report (write docs/results.md)

A measurement is a line of JSON in the cache. What is there already is not measured again, so a run that was stopped
continues, on the same device and with the same steps.
"""

import argparse
import functools
import hashlib
import json
import multiprocessing
import sys
import time
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path

from bench.baselines import device_name
from bench.environment import CACHE, commit, versions
from bench.metrics import Metric
from bench.quality_cases import BY_NAME, CASES, GRID, Case, fits, unknown_setting
from bench.quality_measure import Job, measure
from bench.quality_report import write_report
from bench.quality_scenes import DATA, RECIPES, SETS, load_scene, prepare, prepared, scene_digest
from graphgs.threads import available_cpus

RESULTS = Path(__file__).parent / "results" / "quality.jsonl"  # committed: docs/results.md is made from it
NO_FOLDER = Path("/dev/null")  # of --report: the committed results alone
TOLERANCE = 0.02  # relative, of a PSNR


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this workload."""
    group = parser.add_argument_group("quality")
    group.add_argument("--sets", nargs="+", choices=SETS, default=SETS, metavar="SET", help=", ".join(SETS))
    group.add_argument("--cases", nargs="+", choices=BY_NAME, metavar="CASE", help="these alone (default: all)")
    group.add_argument("--seeds", type=int, default=3, help="trainings per case and set (default: 3)")
    group.add_argument("--steps", type=int, default=2000, help="executed steps of a full training (default: 2000)")
    group.add_argument("--jobs", type=int, default=1, help="trainings at a time, a process each (default: 1)")
    group.add_argument("--again", action="store_true", help="measure also what is there already")
    group.add_argument("--minutes", type=float, help="start nothing new after so many minutes")
    group.add_argument("--commit", default=commit(), help="what is measured (default: asked of git)")
    group.add_argument("--data", type=Path, default=DATA, help="folder of the real photo sets")


def run(device: str, cache: Path, args: argparse.Namespace) -> list[Metric]:
    """Measure what is missing; the method's and the control's PSNR on every set as metrics."""
    cache = cache.resolve()
    if args.data.is_dir() or not prepared(cache):
        prepare(_wanted_scenes(args), cache, args.data, threads=available_cpus())
    store = Store(cache / "quality" / "quality.jsonl")
    Schedule(device, cache, args, store).run()
    metrics = []
    for name in args.sets:
        for case in ("full", "plain tuned"):
            found = [
                row["psnr"]
                for row in store.rows
                if (row["set"], row["case"], row["base_steps"]) == (name, case, args.steps)
                and row["device"] == device_name(device)
            ]
            if found:
                metrics.append(Metric(f"quality/{name}/{case}", sum(found) / len(found), "dB", "higher", TOLERANCE))
    return metrics


class Store:
    """Measurements, one JSON object a line; a half-written last line, left by a kill, is passed over."""

    def __init__(self, path: Path):
        self.path, self.rows = path, []
        if path.is_file():
            for line in path.read_text().splitlines():
                try:
                    self.rows.append(json.loads(line))
                except json.JSONDecodeError:
                    print(f"{path}: a damaged line is passed over")

    def add(self, row: dict) -> None:
        self.rows.append(row)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        broken = self.path.is_file() and self.path.read_bytes()[-1:] not in (b"\n", b"")
        with self.path.open("a") as file:
            file.write(("\n" if broken else "") + json.dumps(row) + "\n")


@dataclass(frozen=True)
class Task:
    case: Case
    set: str
    seed: int

    @property
    def scene(self) -> str:
        return f"{self.set}+{self.case.scene}" if self.case.scene else self.set

    @property
    def needs(self) -> set[tuple[str, int]]:
        """(case, seed) that say what this one is: the grid that tunes the rates, the runs whose seconds are matched."""
        tuned = {(name, 0) for name in GRID} if self.case.tuned else set()
        timed = {(self.case.time_of, self.seed), ("plain tuned", self.seed)} if self.case.time_of else set()
        return tuned | timed


class Schedule:
    """Which training comes next, until all are done or the time is up."""

    def __init__(self, device: str, cache: Path, args: argparse.Namespace, store: Store):
        self._device, self._cache, self._args, self._store = device, cache, args, store
        self._name = device_name(device)
        self._static = {"device": self._name, "jobs": args.jobs, "commit": args.commit, **versions()}
        self._end = time.monotonic() + 60 * args.minutes if args.minutes else float("inf")

    def run(self) -> None:
        there = set(prepared(self._cache))
        waiting = list(self._tasks(there))
        total = len(waiting)
        if not waiting:
            print("quality: everything is measured")
            return
        for name in sorted({task.scene for task in waiting}):
            load_scene(self._cache, name, threads=available_cpus())  # undistorted once, before workers meet there
        print(f"quality: {total} trainings to run, {self._args.jobs} at a time", flush=True)
        running: dict[Future, Task] = {}
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(self._args.jobs, mp_context=context) as pool:
            if self._device != "cpu":  # compile the kernels once, not in every worker
                failure = pool.submit(measure, self._job(waiting[0], warm_up=True)).exception()
                if failure is not None:
                    print(f"quality: warming up failed: {type(failure).__name__}: {failure}", flush=True)
            while waiting or running:
                while waiting and len(running) < self._args.jobs and time.monotonic() < self._end:
                    ready = next((t for t in waiting if self._is_ready(t, [*waiting, *running.values()])), None)
                    if ready is None:
                        break
                    waiting.remove(ready)
                    running[pool.submit(measure, self._job(ready))] = ready
                if not running:
                    break
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    self._keep(running.pop(future), future, total - len(waiting) - len(running))
        if waiting:
            print(f"quality: stopped with {len(waiting)} of {total} trainings left; run it again to go on")

    def _tasks(self, there: set[str]) -> Iterator[Task]:
        """What is to be measured, first things first: by the case's order and the seed, then by set."""
        args, chosen, noted = self._args, [], set()
        for order, case in enumerate(CASES):
            if args.cases and case.name not in args.cases:
                continue
            if (reason := unknown_setting(case)) is not None:
                print(f"quality: no '{case.name}' here ({reason})")
                continue
            for set_order, name in enumerate(args.sets):
                for seed in range(min(args.seeds, case.seeds or args.seeds)):
                    task = Task(case, name, seed)
                    there_already = self._find(case.name, name, seed) is not None and not args.again
                    if not fits(case, name) or there_already:
                        continue
                    if task.scene not in there:
                        noted.add(task.scene)
                        continue
                    chosen.append(((case.order + seed * case.per_seed, set_order, order), task))
        for scene in sorted(noted):
            print(f"quality: {scene} is not prepared, so its cases are left out")
        return (task for _, task in sorted(chosen, key=lambda entry: entry[0]))

    def _find(self, case: str, name: str, seed: int) -> dict | None:
        """The last measurement of this, if there is one."""
        wanted = (case, name, seed, self._args.steps, self._name, self._definition(case, name))
        keys = ("case", "set", "seed", "base_steps", "device", "definition")
        return next((r for r in reversed(self._store.rows) if tuple(r.get(k) for k in keys) == wanted), None)

    @functools.cache  # noqa: B019 - lives as long as the run
    def _definition(self, case: str, name: str) -> str:
        scene = Task(BY_NAME[case], name, 0).scene
        content = json.dumps([BY_NAME[case].definition, scene_digest(self._cache, scene)])
        return hashlib.sha256(content.encode()).hexdigest()[:12]

    def _is_ready(self, task: Task, unfinished: list[Task]) -> bool:
        """Whether what it builds on is measured, or never will be."""
        return not any(other.set == task.set and (other.case.name, other.seed) in task.needs for other in unfinished)

    def _seconds(self, case: str, task: Task) -> float | None:
        """[s] that the case took, finding dense points included: with the same seed, or else the first."""
        row = self._find(case, task.set, task.seed) or self._find(case, task.set, 0)
        return None if row is None else row["seconds"] + row.get("dense_s", 0.0)

    def _job(self, task: Task, *, warm_up: bool = False) -> Job:
        case, rates, steps = task.case, task.case.rates, self._args.steps * task.case.steps
        if case.tuned:
            scores = {name: row["psnr"] for name in GRID if (row := self._find(name, task.set, 0)) is not None}
            rates = BY_NAME[max(scores, key=scores.get)].rates if scores else rates
        if case.time_of:
            ours, control = (self._seconds(name, task) for name in (case.time_of, "plain tuned"))
            steps *= ours / control if ours and control else 1.0
        threads = max(1, available_cpus() // self._args.jobs)
        return Job(
            case, task.set, task.scene, task.seed, 10 if warm_up else max(1, round(steps)), rates,
            cache=self._cache, device=self._device, threads=threads,
        )  # fmt: skip

    def _keep(self, task: Task, future: Future, done: int) -> None:
        label = f"{task.set:14} {task.case.name:26} seed {task.seed}"
        if (error := future.exception()) is not None:
            print(f"{done:4} {label} failed: {type(error).__name__}: {error}", flush=True)
            return
        told = {"base_steps": self._args.steps, "definition": self._definition(task.case.name, task.set)}
        row = future.result() | told | self._static
        self._store.add(row)
        print(
            f"{done:4} {label} {row['psnr']:6.2f} dB  {row['splats']:6} Gaussians  {row['seconds']:6.1f} s", flush=True
        )


def _wanted_scenes(args: argparse.Namespace) -> list[str]:
    chosen = [BY_NAME[name] for name in args.cases] if args.cases else CASES
    variants = {case.scene for case in chosen if case.scene}
    return [
        name
        for name in RECIPES
        if name.split("+")[0] in args.sets and ("+" not in name or name.split("+")[1] in variants)
    ]


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m bench.quality", description="How good scenes are, beside controls."
    )
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0 (default: cpu)")
    parser.add_argument("--cache", type=Path, default=CACHE, help=f"folder for inputs and results (default: {CACHE})")
    parser.add_argument("--prepare", action="store_true", help="make the inputs, and train nothing")
    parser.add_argument("--threads", type=int, default=available_cpus(), help="of --prepare")
    parser.add_argument(
        "--report", nargs="?", const=NO_FOLDER, type=Path, metavar="FOLDER",
        help="write docs/results.md from the committed results, or first take those in FOLDER (CACHE/quality)",
    )  # fmt: skip
    add_arguments(parser)
    args = parser.parse_args()
    if args.prepare:
        prepare(_wanted_scenes(args), args.cache.resolve(), args.data, threads=args.threads)
    elif args.report is not None:
        if args.report != NO_FOLDER:
            RESULTS.parent.mkdir(exist_ok=True)
            taken = Store(args.report / "quality.jsonl").rows
            devices = {row["device"] for row in taken}
            kept = [row for row in Store(RESULTS).rows if row["device"] not in devices]
            RESULTS.write_text("".join(json.dumps(row) + "\n" for row in [*kept, *taken]))
        docs = Path(__file__).resolve().parents[1] / "docs"
        print(write_report(Store(RESULTS).rows, docs, pictures=args.report / "pictures"))
    else:
        for metric in run(args.device, args.cache, args):
            print(f"{metric.name:44} {metric.value:10.2f} {metric.unit}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
