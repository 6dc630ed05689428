"""The commands beside run, pose and train: check, eval, render, synth."""

import dataclasses
import json
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from graphgs.api import choose_device, settings
from graphgs.config import Config
from graphgs.console import RunReporter
from graphgs.errors import DataError, UsageError
from graphgs.evaluation.evaluate import evaluate, render_view
from graphgs.evaluation.picture_names import picture_names
from graphgs.export.ply import read_ply
from graphgs.forecast import forecast
from graphgs.options import Options
from graphgs.outputs import publish_pictures
from graphgs.pipeline import VIEWS, decode_side
from graphgs.progress import Reporter
from graphgs.rendering.splats import Splats
from graphgs.scene.views import Views
from graphgs.sources import Scan, scan
from graphgs.sources.look import look_at_given
from graphgs.structure.given_sample import sample
from graphgs.structure.held import hold_given
from graphgs.synth.street import StreetConfig, write_street
from graphgs.threads import get_num_threads
from graphgs.workspace import Workspace, make_writable, write_json

_NAMES_SHOWN = 10


def check(source: Path, options: Options) -> Iterator[str]:
    """Lines about the input. Raises DataError where a run could not work."""
    config = settings(options)
    found = scan(source, rigs=config.sources.rigs == "auto")
    yield f"{found.root}: {len(found.names)} usable photos ({found.kind})"
    for (width, height), count in Counter(map(tuple, found.sizes.tolist())).most_common(_NAMES_SHOWN):
        yield f"  {count} of {width} x {height} px"
    if found.masks:
        yield f"  {found.masks} with a mask"
    for rig in found.rigs:
        yield f"  {rig.description}"
    if found.note:
        yield f"  {found.note}"
    for skipped in found.skipped[:_NAMES_SHOWN]:
        yield f"  not used: {skipped.name}: {skipped.reason}"
    if len(found.skipped) > _NAMES_SHOWN:
        yield f"  not used: {len(found.skipped) - _NAMES_SHOWN} more"
    if len(found.names) < 3:
        raise DataError(
            f"{source}: {len(found.names)} usable photos; at least 3 are needed", hint="add photos that overlap by half"
        )
    threads = options.threads or get_num_threads()
    if config.structure.poses != "prior":
        yield from _given_lines(config, source, found, threads)
    yield from forecast(config, found.sizes, threads=threads).lines()


def _given_lines(config: Config, source: Path, found: Scan, threads: int) -> Iterator[str]:
    """What a sample of the photos says of the poses that came with them, as `pose` would. Raises what it would."""
    if found.kind == "photos":
        return
    sources = dataclasses.replace(config.sources, decode_max_side=decode_side(config))
    with tempfile.TemporaryDirectory(prefix="graphgs-check-") as folder:
        photos = look_at_given(sources, source, Path(folder) / "photos", sample, threads=threads)
        if photos is None or len(photos.given.names) < 2:
            return
        held = hold_given(
            config.structure, sources, photos, scratch=Path(folder) / "held", reporter=Reporter(), threads=threads
        )
    refusal = held.refusal()
    if refusal is not None and not config.run.allow_partial:
        raise refusal
    yield f"  {'; '.join(held.cautions) or held.describe()}"


def evaluate_scene(scene: Path, *, device: str) -> Iterator[str]:
    """Measure splat.ply on the held-out views; pictures and evaluation.json go into eval/."""
    splats, views = _scene(scene)
    device, threads = choose_device(device), get_num_threads()
    with tempfile.TemporaryDirectory(dir=scene, prefix=".eval-") as made:
        result = evaluate(splats, views, Path(made), device=device, threads=threads, reporter=RunReporter(quiet=True))
        publish_pictures(Path(made), scene / "eval")
    result.save(scene / "eval")
    for view in result.views:
        yield f"{view.psnr:6.2f} dB  SSIM {view.ssim:.4f}  {view.name}"
    for name in result.missing:
        yield f"  missing        {name}"
    if result.psnr is not None:
        yield f"{result.psnr:6.2f} dB  SSIM {result.ssim:.4f}  mean of {len(result.views)}"


def render_scene(scene: Path, output: Path, *, views: Literal["test", "train", "all"], device: str) -> int:
    """PNG pictures of the scene from its own cameras; returns how many."""
    splats, posed = _scene(scene)
    wanted = {"test": posed.is_test, "train": ~posed.is_test, "all": np.ones(len(posed.names), bool)}[views]
    splats = splats.to(choose_device(device))
    chosen = np.flatnonzero(wanted)
    make_writable(output)
    for i, name in zip(chosen, picture_names(tuple(posed.names[k] for k in chosen)), strict=True):
        path = output / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        image = (render_view(splats, posed, i) * 255.0 + 0.5).astype(np.uint8)
        path.write_bytes(cv2.imencode(".png", image[..., ::-1])[1].tobytes())
    return len(chosen)


def synthesize(kind: Literal["street"], output: Path, config: StreetConfig) -> str:
    """Write a synthetic photo set; returns what to say about it. Nothing is remade if the same set is there already."""
    made = output / "street.json"
    wanted = {"kind": kind, **{name: getattr(config, name) for name in config.__dataclass_fields__}}
    if made.is_file() and json.loads(made.read_text()) == wanted:
        return f"{output}: already there"
    make_writable(output)
    street = write_street(config, output, reporter=RunReporter(), threads=get_num_threads())
    write_json(made, wanted)
    return f"{len(street.reconstruction.names)} photos in {street.images}, their true poses in {street.truth}"


def _scene(scene: Path) -> tuple[Splats, Views]:
    splat = scene / "splat.ply"
    if not splat.is_file():
        raise UsageError(f"{scene}: no trained scene there (splat.ply is missing)", hint="run `graphgs run` first")
    with Workspace(scene) as workspace:
        found = workspace.find(VIEWS)
    if found is None:
        raise UsageError(
            f"{scene}: its undistorted views are gone (the cache was deleted)", hint="run `graphgs run` again"
        )
    return read_ply(splat), Views.load(found.folder)
