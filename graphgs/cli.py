"""The command line: graphgs run | check | pose | explain | train | eval | render | synth. Flags are dataclasses."""

import dataclasses
import errno
import os
import shlex
import signal
import sys
import tempfile
import traceback
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from graphgs.console import RunReporter, printable
from graphgs.errors import DiskError, GraphGSError, OutOfMemoryError
from graphgs.options import Options
from graphgs.synth.street import StreetConfig
from graphgs.versions import version_line

Settings = Annotated[UseAppendAction[tuple[str, ...]], arg(name="set", metavar="STAGE.FIELD=VALUE")]
Input = Annotated[Positional[Path], arg(metavar="INPUT")]
Output = Annotated[Positional[Path], arg(metavar="OUTPUT")]
Scene = Annotated[Positional[Path], arg(metavar="SCENE")]

READER_WENT_AWAY = 128 + 13  # as a shell says of a program that SIGPIPE ended
_DESCRIPTION = "Photos without poses in, a trained 3D scene out. `graphgs --version` tells what is installed."

app = tyro.extras.SubcommandApp()


@app.command
def run(
    input: Input,
    output: Output,
    options: OmitArgPrefixes[Options] = Options(),  # noqa: B008 - frozen
    settings: Settings = (),
    json: bool = False,
) -> None:
    """Photos in, a trained scene out. Run the same command again and it continues.

    Args:
        input: A folder of photos, a COLMAP project, a transforms.json, or KITTI poses.
        output: The folder for splat.ply, report.html and the rest.
        options: The settings people change most.
        settings: Any setting, for example --set training.sh_degree=2; repeat for more.
        json: One JSON event per line instead of text.
    """
    from graphgs import api

    _finished(api.run(input, output, **_arguments(options, settings, json)), json)


@app.command
def pose(
    input: Input,
    output: Output,
    options: OmitArgPrefixes[Options] = Options(),  # noqa: B008 - frozen
    settings: Settings = (),
    json: bool = False,
) -> None:
    """Camera poses only: a COLMAP model of the undistorted photos, the camera graph and a report.

    Args:
        input: A folder of photos, a COLMAP project, a transforms.json, or KITTI poses.
        output: The folder for colmap/, report.html and the rest.
        options: The settings people change most.
        settings: Any setting, for example --set structure.fine_features=8192; repeat for more.
        json: One JSON event per line instead of text.
    """
    from graphgs import api

    _finished(api.pose(input, output, **_arguments(options, settings, json)), json)


@app.command
def train(
    scene: Scene,
    options: OmitArgPrefixes[Options] = Options(),  # noqa: B008 - frozen
    settings: Settings = (),
    json: bool = False,
) -> None:
    """Train on the poses that `pose` or `run` left in a scene folder, with its settings unless others are given.

    Args:
        scene: An output folder of `graphgs pose` or `graphgs run`.
        options: The settings people change most.
        settings: Any setting, for example --set training.sampling=uniform; repeat for more.
        json: One JSON event per line instead of text.
    """
    from graphgs import api

    _finished(api.train(scene, **_arguments(options, settings, json)), json)


@app.command
def check(input: Input, options: OmitArgPrefixes[Options] = Options()) -> None:  # noqa: B008 - frozen
    """Look at the input without working on it: what would be used, what not and why, and what a run would cost.

    Args:
        input: What would be given to `graphgs run`.
        options: The settings the run would have.
    """
    from graphgs import commands

    for line in commands.check(input, options):
        print(printable(line))


@app.command
def explain(scene: Scene, image: Annotated[Positional[str], arg(metavar="IMAGE")] = "", json: bool = False) -> None:
    """Say how a scene hangs together, or all about one photo, from what its run left.

    Args:
        scene: An output folder of `graphgs pose` or `graphgs run`.
        image: A photo's name, or the end of one; without it, the whole scene: groups, photos left out, weak cameras.
        json: One JSON event instead of text.
    """
    from graphgs import explain as answers

    found = answers.read_artefacts(scene)
    if image:
        facts = answers.photo_facts(found, answers.find_photo(found, image))
        kind, lines = "photo", answers.photo_lines(facts)
    else:
        facts = answers.scene_facts(found)
        kind, lines = "scene", answers.scene_lines(facts)
    if json:
        RunReporter(as_json=True).event(kind, **facts)
        return
    for line in lines:
        print(printable(line))


@app.command(name="eval")
def evaluate(scene: Scene, device: str = "auto") -> None:
    """Measure splat.ply of a scene folder on its held-out views again.

    Args:
        scene: An output folder of `graphgs run`.
        device: auto, cpu or cuda:0.
    """
    from graphgs import commands

    for line in commands.evaluate_scene(scene, device=device):
        print(printable(line))


@app.command
def render(scene: Scene, output: Output, views: Literal["test", "train", "all"] = "test", device: str = "auto") -> None:
    """Render splat.ply of a scene folder from its own cameras.

    Args:
        scene: An output folder of `graphgs run`.
        output: The folder for the pictures, PNG.
        views: Which cameras.
        device: auto, cpu or cuda:0.
    """
    from graphgs import commands

    count = commands.render_scene(scene, output, views=views, device=device)
    print(printable(f"{count} pictures in {output}"))


@app.command
def synth(
    kind: Positional[Literal["street"]],
    output: Output,
    config: OmitArgPrefixes[StreetConfig] = StreetConfig(),  # noqa: B008 - frozen
) -> None:
    """Make a photo set whose true poses and depths are known.

    Args:
        kind: street: a drive between textured house fronts.
        output: The folder for images/ and truth/.
        config: What to make.
    """
    from graphgs import commands

    print(printable(commands.synthesize(kind, output, config)))


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code: 0 ok, 1 bug, 2 usage, 3 data, 4 memory, 5 disk, 130 interrupted, 141
    where the reader of what is printed went away."""
    signal.signal(signal.SIGTERM, _terminate)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed before we began (`>&-`): nobody will read
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 - as long as the process lives
    sys.exit(_guarded(arguments))


def _guarded(arguments: list[str] | None) -> int:
    """The exit code. Whatever was printing when the reader went away (`| head -1`), it ends here, and quietly."""
    try:
        try:
            return _answered(sys.argv[1:] if arguments is None else arguments)
        finally:
            sys.stdout.flush()  # now, for at the interpreter's end nobody could answer a closed pipe
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            os.dup2(nowhere, stream.fileno())
        return READER_WENT_AWAY


def _answered(arguments: list[str]) -> int:
    try:
        if arguments == ["--version"]:
            print(version_line())
        else:
            app.cli(prog="graphgs", args=arguments, description=_DESCRIPTION)
    except BrokenPipeError:
        raise
    except GraphGSError as error:
        return _say(error)
    except KeyboardInterrupt:
        print("interrupted; what was done is saved, the same command continues", file=sys.stderr)
        return 130
    except MemoryError:
        return _say(OutOfMemoryError("out of memory", hint="use a smaller --max-side or --max-splats"))
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return _say(
                DiskError(f"the disk is full: {error.filename or ''}", hint="free some space; the run continues")
            )
        return _bug(error)
    except Exception as error:
        return _bug(error)
    return 0


def _say(error: GraphGSError) -> int:
    print(f"error: {printable(error.message)}", file=sys.stderr)
    if error.hint:
        print(f"       {printable(error.hint)}", file=sys.stderr)
    if error.command:
        print(f"       {printable(error.command)}", file=sys.stderr)
    return error.exit_code


def _bug(error: BaseException) -> int:
    """The traceback goes to a file: a person needs one line, whoever mends it needs all."""
    with tempfile.NamedTemporaryFile("w", prefix="graphgs-crash-", suffix=".txt", delete=False) as file:
        traceback.print_exception(error, file=file)
    print(f"error: a bug in graphgs: {type(error).__name__}: {printable(str(error))}", file=sys.stderr)
    print(f"       the details are in {file.name}; please report them. What was done is saved.", file=sys.stderr)
    return GraphGSError.exit_code


def _terminate(number: int, frame) -> None:
    raise KeyboardInterrupt


def _arguments(options: Options, settings: tuple[str, ...], json: bool) -> dict:
    given = {field.name: getattr(options, field.name) for field in dataclasses.fields(options)}
    return given | {
        "settings_extra": settings,
        "reporter": RunReporter(as_json=json),
        "command": shlex.join(["graphgs", *sys.argv[1:]]),
    }


def _finished(result, json: bool) -> None:
    if json:
        return
    metrics = result.metrics
    print(printable(metrics["partial"] or f"done: {metrics['registered']} of {metrics['images']} photos placed"))
    for caution in metrics["cautions"]:
        print(printable(f"      caution: {caution}"))
    if metrics["psnr"] is not None:
        views = len(metrics["views"])
        print(f"      {metrics['num_splats']} Gaussians, {metrics['psnr']:.2f} dB on {views} held-out views")
    total = sum(metrics["seconds"].values())
    print(f"      {total:.0f} s in all, at most {metrics['peak_rss_mb']} MB of memory")
    print(printable(f"      {result.report_path}"))
    if result.splat_path.exists():
        print(printable(f"      {result.splat_path}"))


if __name__ == "__main__":
    main()
