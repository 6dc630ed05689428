"""What a run left behind that questions are answered from: only what belongs together."""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from graphgs.config import Config, with_file
from graphgs.errors import UsageError
from graphgs.graph import CameraGraph
from graphgs.sources.photos import Photos
from graphgs.stages import EVALUATION, GRAPH, MAPPING, MATCHES, PAIRS, PHOTOS, STAGES, VIEWS
from graphgs.structure.config import StructureConfig
from graphgs.structure.diagnosis import Diagnosis
from graphgs.structure.pairing import Pairs
from graphgs.structure.result import Structure
from graphgs.workspace import Stage, find_stage


@dataclass(frozen=True)
class Artefacts:
    """None: the run had no need of it, or did not get that far."""

    photos: Photos
    structure: Structure
    graph: CameraGraph | None
    pairs: Pairs | None
    scores: dict[str, float] | None  # [dB] PSNR per measured held-out view
    limits: StructureConfig  # in force when the poses were found

    @property
    def diagnosis(self) -> Diagnosis | None:
        return self.structure.diagnosis

    @cached_property
    def row(self) -> dict[str, int]:
        """Index of every photo among all photos."""
        return {name: k for k, name in enumerate(self.photos.names)}

    @cached_property
    def node(self) -> dict[str, int]:
        """Index of every placed photo in the reconstruction."""
        return {name: k for k, name in enumerate(self.structure.reconstruction.names)}


def read_artefacts(scene: Path) -> Artefacts:
    """The finished stages of a scene folder. Raises UsageError where there are no poses yet."""
    mapping, photos = find_stage(scene, MAPPING), find_stage(scene, PHOTOS)
    if mapping is None or photos is None:
        raise _not_yet(scene)
    if photos.key not in mapping.inputs:
        raise UsageError(
            f"{scene}: its camera poses belong to other photos or settings than the ones read last",
            hint="finish with `graphgs pose` or `graphgs run`, then ask again",
        )

    def made_from(stage: Stage, *keys: str):
        """The stage, if all of `keys` are among its inputs."""
        found = find_stage(scene, stage)
        return found if found is not None and set(keys) <= set(found.inputs) else None

    graph, views = made_from(GRAPH, mapping.key), made_from(VIEWS, mapping.key)
    evaluation = None if views is None else made_from(EVALUATION, views.key)
    matches, pairs = find_stage(scene, MATCHES), find_stage(scene, PAIRS)
    matched = matches is not None and matches.key in mapping.inputs
    paired = matched and pairs is not None and pairs.key in matches.inputs
    return Artefacts(
        photos=Photos.load(photos.folder),
        structure=Structure.load(mapping.folder),
        graph=None if graph is None else CameraGraph.load(graph.folder),
        pairs=Pairs.load(pairs.folder) if paired else None,
        scores=None if evaluation is None else _scores(evaluation.folder),
        limits=_settings(scene).structure,
    )


def _settings(scene: Path) -> Config:
    """Those of the run; the defaults where it did not come to write them down."""
    written = scene / "run.toml"
    return with_file(Config(), written) if written.is_file() else Config()


def _scores(folder: Path) -> dict[str, float]:
    saved = json.loads((folder / "evaluation.json").read_text(encoding="utf-8"))
    return {view["name"]: view["psnr"] for view in saved["views"]}


def _not_yet(scene: Path) -> UsageError:
    done = [stage.name for stage in STAGES if find_stage(scene, stage) is not None]
    stopped = _last_words(scene / "log.jsonl")
    if not done and not stopped:
        return UsageError(f"{scene}: no scene there", hint="run `graphgs pose PHOTOS SCENE` or `graphgs run` first")
    reached = f"it got as far as '{done[-1]}'" if done else "it got nowhere"
    return UsageError(
        f"{scene}: no camera poses there yet; {reached}{f' and stopped: {stopped}' if stopped else ''}",
        hint="the same `graphgs pose` or `graphgs run` continues; `graphgs check PHOTOS` looks at the photos alone",
    )


def _last_words(log: Path) -> str:
    """What the last run stopped with; empty where it did not say."""
    try:
        lines = log.read_text(encoding="utf-8").splitlines()
    except OSError:
        return ""
    for line in reversed(lines):
        try:
            event = json.loads(line)
        except ValueError:  # cut short by a kill
            continue
        if event.get("event") == "stopped":
            return event.get("message", "")
        if event.get("event") == "run":
            return ""
    return ""
