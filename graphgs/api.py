"""The same work as the command line, from Python."""

import dataclasses
import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from graphgs.config import Config, check_numbers, preset, with_file, with_settings
from graphgs.console import RunReporter
from graphgs.errors import DataError, PartialError, UsageError
from graphgs.options import SETTING_OF_OPTION, Options
from graphgs.outputs import Made, write_outputs
from graphgs.pipeline import Posed, Run, find_poses, make_scene, resume_poses
from graphgs.stages import MAPPING
from graphgs.structure.shortfall import partial_error
from graphgs.threads import get_num_threads, set_num_threads
from graphgs.workspace import Workspace


@dataclass(frozen=True)
class RunResult:
    """What a finished run left in its output folder."""

    output: Path
    metrics: dict[str, Any]  # as in metrics.json
    status: str  # complete, posed (stopped after the poses), or partial: the photos are not all there

    @property
    def splat_path(self) -> Path:
        return self.output / "splat.ply"

    @property
    def report_path(self) -> Path:
        return self.output / "report.html"


def settings(options: Options, extra: Iterable[str] = (), *, base: Config | None = None) -> Config:
    """The config the options ask for: `base`, then the preset, the file, the options, `stage.field=value`.
    Raises UsageError for a value that no stage could work with."""
    if base is None:
        config = preset(options.preset or "standard")
    else:
        config = base if options.preset is None else preset(options.preset, base)
    if options.config is not None:
        config = with_file(config, options.config)
    given = [
        f"{SETTING_OF_OPTION[name]}={getattr(options, name)}"
        for name in SETTING_OF_OPTION
        if getattr(options, name) is not None
    ]
    if options.allow_partial:
        given.append("run.allow_partial=true")
    config = with_settings(config, [*given, *extra])
    check_numbers(config)
    if options.threads is not None and options.threads < 1:
        raise UsageError(f"--threads {options.threads}: expected at least 1", hint="correct the value")
    return config


def run(
    source: str | Path,
    output: str | Path,
    *,
    settings_extra: Iterable[str] = (),
    reporter: RunReporter | None = None,
    command: str = "",
    **options,
) -> RunResult:
    """Photos in, a trained scene out; run it again and it continues. `options` are the fields of `Options`.

    Raises graphgs.errors.GraphGSError: what went wrong, what to do; a PartialError after the report is written."""
    chosen = _options(options)
    config = settings(chosen, settings_extra)
    with _opened(Path(source), Path(output), config, chosen, reporter) as job:
        posed = find_poses(job)
        return _finish(job, posed, command or f"graphgs.run({str(source)!r}, {str(output)!r})")


def pose(
    source: str | Path,
    output: str | Path,
    *,
    settings_extra: Iterable[str] = (),
    reporter: RunReporter | None = None,
    command: str = "",
    **options,
) -> RunResult:
    """Camera poses only: colmap/, graph.json and a report. Raises as `run` does."""
    chosen = _options(options)
    config = settings(chosen, settings_extra)
    with _opened(Path(source), Path(output), config, chosen, reporter) as job:
        posed = find_poses(job)
        error = _partial(job, posed)
        metrics = write_outputs(job, posed, None, command=command, partial=error)
        if error is not None and not config.run.allow_partial:
            raise error
        return RunResult(job.workspace.output, metrics, metrics["status"])


def train(
    scene: str | Path,
    *,
    settings_extra: Iterable[str] = (),
    reporter: RunReporter | None = None,
    command: str = "",
    **options,
) -> RunResult:
    """Train on the poses that `run` or `pose` left in `scene`, with its settings unless others are given."""
    chosen = _options(options)
    folder = Path(scene)
    if not (folder / "run.toml").is_file():
        raise UsageError(
            f"{folder}: no scene there (run.toml is missing)", hint="run `graphgs pose PHOTOS SCENE` first"
        )
    config = settings(chosen, settings_extra, base=with_file(Config(), folder / "run.toml"))
    with _opened(None, folder, config, chosen, reporter) as job:
        return _finish(job, resume_poses(job), command or f"graphgs.api.train({str(scene)!r})")


def _finish(job: Run, posed, command: str) -> RunResult:
    error = _partial(job, posed)
    if error is not None and not job.config.run.allow_partial:
        write_outputs(job, posed, None, command=command, partial=error)
        raise error
    made = Made(*make_scene(job, posed))
    metrics = write_outputs(job, posed, made, command=command, partial=error)
    return RunResult(job.workspace.output, metrics, metrics["status"])


def _partial(job: Run, posed: Posed) -> PartialError | None:
    return partial_error(posed.structure, len(posed.photos.photos), job.config.structure)


class _opened:
    """A run in its workspace: the lock, the log, the number of threads; all given back at the end."""

    def __init__(
        self, source: Path | None, output: Path, config: Config, options: Options, reporter: RunReporter | None
    ):
        self._source, self._output, self._config, self._options = source, output, config, options
        self._reporter = reporter or RunReporter(quiet=True)
        self._threads = get_num_threads()

    def __enter__(self) -> Run:
        if self._source is not None and not self._source.exists():
            raise UsageError(f"{self._source} does not exist", hint="give a folder of photos")
        if self._source is not None and self._source.resolve() == self._output.resolve():
            raise UsageError(f"{self._output}: input and output are the same", hint="choose another output folder")
        device = choose_device(self._config.run.device)
        self._workspace = Workspace(self._output)
        if self._options.threads is not None:
            set_num_threads(self._options.threads)
        self._reporter.attach_log(self._output / "log.jsonl")
        self._reporter.event("run", settings=dataclasses.asdict(self._config), threads=get_num_threads())
        self._run = Run(self._config, self._source, self._workspace, self._reporter, get_num_threads(), device)
        return self._run

    def __exit__(self, kind, error, _) -> None:
        if isinstance(error, DataError) and MAPPING.name in self._run.keys:  # there is something to ask
            error.command = shlex.join(["graphgs", "explain", str(self._output)])
        if error is not None:
            self._reporter.event("stopped", reason=kind.__name__, message=str(error))
        set_num_threads(self._threads)
        self._reporter.close()
        self._workspace.close()


def choose_device(name: str) -> str:
    """`auto` as a real device. Raises UsageError for one that is not there."""
    import torch

    if name == "auto":
        return "cuda:0" if torch.cuda.is_available() else "cpu"
    if name == "cpu":
        return name
    if not name.startswith("cuda"):
        raise UsageError(f"--device {name}: not a device", hint="choose auto, cpu or cuda:0")
    cards = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if cards == 0:
        raise UsageError(f"--device {name}: no CUDA card can be used here", hint="use --device cpu or auto")
    wanted = "cuda:0" if name == "cuda" else name
    if wanted not in (there := [f"cuda:{k}" for k in range(cards)]):
        raise UsageError(f"--device {name}: there is no such card", hint=f"choose one of {', '.join(there)}")
    return wanted


def _options(given: dict[str, Any]) -> Options:
    known = {field.name for field in dataclasses.fields(Options)}
    unknown = sorted(given.keys() - known)
    if unknown:
        raise UsageError(f"unknown option {', '.join(unknown)}", hint=f"the options are {', '.join(sorted(known))}")
    if given.get("config") is not None:
        given = {**given, "config": Path(given["config"])}
    return Options(**given)
