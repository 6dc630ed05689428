"""The order of stages: known here and nowhere else.

photos -> coarse -> pairs -> matches -> mapping -> views -> graph -> dense -> points -> training -> evaluation
Poses that came with the photos are held against them before all else.
Each stage is a function from artefacts to an artefact; the workspace keeps them and decides what must run again.
"""

import dataclasses
import fnmatch
import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from graphgs.config import Config
from graphgs.console import RunReporter
from graphgs.errors import UsageError
from graphgs.evaluation.evaluate import Evaluation, evaluate
from graphgs.forecast import forecast
from graphgs.graph import CameraGraph
from graphgs.graph.build import build_camera_graph
from graphgs.points import DenseCloud, PrunedPoints, dense_cloud, initial_points
from graphgs.scene.origin import AT_ZERO, describe
from graphgs.scene.views import Views
from graphgs.sources import Photos, fingerprint, load_photos
from graphgs.stages import (
    COARSE,
    DENSE,
    EVALUATION,
    GIVEN,
    GRAPH,
    MAPPING,
    MATCHES,
    PAIRS,
    PHOTOS,
    POINTS,
    STAGES,
    TRAINING,
    VIEWS,
)
from graphgs.structure.candidates import candidate_pairs
from graphgs.structure.extra_pairs import read_extra_pairs
from graphgs.structure.feature_cache import FeatureCache
from graphgs.structure.given import keep_given, map_given, needs_matching
from graphgs.structure.given_verdict import HeldPoses
from graphgs.structure.held import hold_given
from graphgs.structure.mapping import map_fine
from graphgs.structure.matching import Matches, match_pairs
from graphgs.structure.pairing import Pairs
from graphgs.structure.prior import Prior
from graphgs.structure.priors import make_prior, prior_fingerprint
from graphgs.structure.result import Structure
from graphgs.structure.undistort import undistort
from graphgs.training import train
from graphgs.training.trained import Trained
from graphgs.workspace import Outcome, Stage, Workspace, digest

# The settings each stage reads (patterns over stage.field); a setting that changes reruns what follows from it.
READS: dict[Stage, tuple[str, ...]] = {
    PHOTOS: ("sources.*",),
    GIVEN: (
        "structure.poses", "structure.coarse_max_side", "structure.coarse_features", "structure.sequence_window",
        "structure.retrieval_*",
    ),
    COARSE: (
        "run.seed", "run.prior", "structure.poses", "structure.coarse_*", "structure.sequence_window",
        "structure.retrieval_*", "structure.learned_*", "structure.min_registered",
    ),
    PAIRS: ("pairing.*",),
    MATCHES: ("run.seed", "structure.fine_*", "structure.min_inliers", "structure.bridge_pairs"),
    MAPPING: (
        "run.seed", "structure.poses", "structure.mapper", "structure.min_inliers", "structure.max_error_px",
        "structure.min_angle_deg",
        "structure.min_registered", "structure.max_apart_share", "structure.max_rotation_*",
        "structure.max_camera_shift", "structure.rig_*",
    ),
    VIEWS: ("structure.max_side",),
    GRAPH: (),
    DENSE: ("points.dense*",),
    POINTS: ("points.*", "training.max_splats"),
    TRAINING: ("run.seed", "training.*"),
    EVALUATION: (),
}  # fmt: skip
# Settings that change how a stage works, never what it makes.
WITHOUT_INFLUENCE = {
    "run.device", "run.allow_partial", "structure.chunk_pairs", "training.image_cache_bytes", "training.checkpoint_s",
    "pairing.extra_file",  # its pairs are in the key
}  # fmt: skip

_TITLES = {
    PHOTOS: "Reading the photos",
    GIVEN: "Holding the given poses against the photos",
    COARSE: "Coarse poses from small images",
    PAIRS: "Choosing pairs",
    MATCHES: "Matching the chosen pairs",
    MAPPING: "Triangulation and bundle adjustment",
    VIEWS: "Undistorting",
    GRAPH: "Camera graph",
    DENSE: "Surfaces that photos agree on",
    POINTS: "Initial points",
    TRAINING: "Training Gaussians",
    EVALUATION: "Held-out views",
}


@dataclass(frozen=True)
class Posed:
    """Photos with poses. The steps that a set of given poses made unnecessary are None."""

    photos: Photos
    structure: Structure
    views: Views
    graph: CameraGraph
    prior: Prior | None = None
    pairs: Pairs | None = None
    matches: Matches | None = None
    held: HeldPoses | None = None  # None: the poses are our own

    def with_poses(
        self,
        viewmats: np.ndarray,  # [N, 4, 4] world-to-camera, one for each view
    ) -> "Posed":
        """The same with the poses that training refined, in views, graph and reconstruction; points and what was
        measured with the earlier poses stay."""
        model, graph = self.structure.reconstruction, self.graph
        assert model.names == graph.names == self.views.names
        rotations, translations = viewmats[:, :3, :3], viewmats[:, :3, 3]
        model = dataclasses.replace(model, rotations=rotations, translations=translations)
        return dataclasses.replace(
            self,
            structure=dataclasses.replace(self.structure, reconstruction=model),
            views=dataclasses.replace(self.views, viewmats=viewmats),
            graph=dataclasses.replace(graph, rotations=rotations, centers=model.centers),
        )


@dataclass(frozen=True)
class Run:
    """One run: its settings, its folder, and how it speaks. Collects the seconds per stage as it goes."""

    config: Config
    source: Path | None  # None: go on from the artefacts in the workspace
    workspace: Workspace
    reporter: RunReporter
    threads: int
    device: str
    seconds: dict[str, float] = dataclasses.field(default_factory=dict)
    keys: dict[str, str] = dataclasses.field(default_factory=dict)

    def stage(self, stage: Stage, inputs: list[Stage], produce, load, *, source_key: str = "", scratch=None) -> Any:
        """The artefact of a stage, made or reused; `inputs` are the stages it is made from."""
        self.reporter.stage(stage.order, len(STAGES), _TITLES[stage])
        settings = settings_of(stage, self.config)
        if stage is TRAINING:
            settings["device"] = self.device.split(":")[0]
        outcome: Outcome = self.workspace.run(
            stage,
            settings=settings,
            inputs=[self.keys[i.name] for i in inputs if i.name in self.keys] + [source_key],
            produce=produce,
            load=load,
            reporter=self.reporter,
            scratch=scratch,
        )
        self.keys[stage.name], self.seconds[stage.name] = outcome.key, outcome.seconds
        if outcome.reused:
            self.reporter.info("unchanged, reused")
        return outcome.artefact

    def found(self, stage: Stage, load, used: tuple[str, ...]) -> Any:
        """The artefact of an earlier run, whatever its settings were; None unless its key is among those `used`."""
        found = self.workspace.find(stage)
        if found is None or found.key not in used:
            return None
        self.keys[stage.name], self.seconds[stage.name] = found.key, found.seconds
        return load(found.folder)


def settings_of(stage: Stage, config: Config) -> dict[str, Any]:
    """The settings a stage reads, as `stage.field: value`."""
    flat = flat_settings(config)
    return {
        name: value
        for name, value in flat.items()
        if name not in WITHOUT_INFLUENCE and any(fnmatch.fnmatchcase(name, pattern) for pattern in READS[stage])
    }


def flat_settings(config: Config) -> dict[str, Any]:
    return {
        f"{room}.{name}": value for room, fields in dataclasses.asdict(config).items() for name, value in fields.items()
    }


def find_poses(run: Run) -> Posed:
    """Photos in, posed views and their graph out. Raises DataError where the photos cannot work."""
    config, reporter, threads = run.config, run.reporter, run.threads
    photos = _photos(run)
    if run.workspace.find(MAPPING) is None:
        sizes = np.array([(photo.width, photo.height) for photo in photos.photos]).reshape(-1, 2)
        reporter.info(forecast(config, sizes, threads=threads).line(run.device))
    given = photos.given is not None and config.structure.poses != "prior"
    held = _held(run, photos) if given else None
    if given and not needs_matching(config.structure, photos):
        structure = run.stage(
            MAPPING,
            [PHOTOS, GIVEN],
            lambda folder, scratch: keep_given(config.structure, photos, held.cautions),
            Structure.load,
        )
        return _viewed(run, photos, structure, None, None, None, held)
    prior, pairs, matches = _matched(run, photos)
    map_photos = functools.partial(map_given, cautions=held.cautions) if given else map_fine
    structure = run.stage(
        MAPPING,
        [PHOTOS, GIVEN, COARSE, MATCHES],
        lambda folder, scratch: map_photos(
            config.structure, photos, matches, prior,
            scratch=scratch, reporter=reporter, threads=threads, seed=config.run.seed,
        ),
        Structure.load,
    )  # fmt: skip
    return _viewed(run, photos, structure, prior, pairs, matches, held)


def _held(run: Run, photos: Photos) -> HeldPoses:
    """What the photos say of the poses that came with them. Raises DataError for poses that cannot be right, unless
    partial results are asked for."""
    config = run.config
    held = run.stage(
        GIVEN,
        [PHOTOS],
        lambda folder, scratch: hold_given(
            config.structure, config.sources, photos,
            scratch=scratch, reporter=run.reporter, threads=run.threads,
            cache=FeatureCache(run.workspace.cache / "features"),
        ),
        HeldPoses.load,
    )  # fmt: skip
    refusal = held.refusal()
    if refusal is not None and not config.run.allow_partial:
        raise refusal
    if held.verdict == "open":
        run.reporter.info(held.describe())
    return held


def resume_poses(run: Run) -> Posed:
    """The poses an earlier run left in the workspace. Raises UsageError if there are none."""
    mapping, matched = run.workspace.find(MAPPING), run.workspace.find(MATCHES)
    if mapping is None:
        raise UsageError(
            f"{run.workspace.output}: no camera poses there",
            hint="run `graphgs pose PHOTOS SCENE` or `graphgs run` first",
        )
    # Only what the poses were made from: the workspace may hold newer steps of a run that did not get to them.
    photos = run.found(PHOTOS, Photos.load, mapping.inputs)
    if photos is None:
        raise UsageError(
            f"{run.workspace.output}: its camera poses belong to other photos or settings than the ones read last",
            hint="finish with `graphgs pose` or `graphgs run`, then train",
        )
    prior = run.found(COARSE, Prior.load, mapping.inputs)
    from_matches = matched.inputs if matched is not None and matched.key in mapping.inputs else ()
    pairs = run.found(PAIRS, Pairs.load, from_matches)
    matches = run.found(MATCHES, Matches.load, mapping.inputs)
    structure = run.found(MAPPING, Structure.load, (mapping.key,))
    held = run.found(GIVEN, HeldPoses.load, mapping.inputs)
    return _viewed(run, photos, structure, prior, pairs, matches, held)


def make_scene(run: Run, posed: Posed) -> tuple[Trained, Evaluation]:
    """From posed views to a trained scene and its figures on held-out views."""
    config, reporter, threads = run.config, run.reporter, run.threads
    model = posed.structure.reconstruction
    dense = run.stage(
        DENSE,
        [MAPPING, VIEWS],
        lambda folder, scratch: dense_cloud(
            config.points, model, posed.views, reporter=reporter, threads=threads, scratch=scratch
        ),
        DenseCloud.load,
    )
    points = run.stage(
        POINTS,
        [MAPPING, DENSE],
        lambda folder, scratch: initial_points(
            config.points, model, dense,
            max_splats=config.training.max_splats, reporter=reporter, threads=threads,
        ),
        PrunedPoints.load,
    )  # fmt: skip

    def produce(folder: Path, scratch: Path) -> Trained:
        return train(
            config.training, posed.views, posed.graph, points, surfaces=dense,
            scratch=scratch, device=run.device, seed=config.run.seed, threads=threads, reporter=reporter,
        )  # fmt: skip

    checkpoints = run.workspace.output / "checkpoints"
    trained = run.stage(TRAINING, [VIEWS, GRAPH, DENSE, POINTS], produce, Trained.load, scratch=checkpoints)
    evaluation = run.stage(
        EVALUATION,
        [VIEWS, TRAINING],
        lambda folder, scratch: evaluate(
            trained.splats, posed.views, folder, device=run.device, threads=threads, reporter=reporter
        ),
        Evaluation.load,
    )
    return trained, evaluation


def _photos(run: Run) -> Photos:
    config = run.config
    sources = dataclasses.replace(config.sources, decode_max_side=decode_side(config))
    settled = dataclasses.replace(run, config=dataclasses.replace(config, sources=sources))
    return settled.stage(
        PHOTOS,
        [],
        lambda folder, scratch: load_photos(
            sources, run.source, folder, reporter=run.reporter, threads=run.threads, exclude=run.workspace.output
        ),
        Photos.load,
        source_key=fingerprint(run.source, exclude=run.workspace.output, rigs=sources.rigs == "auto"),
    )


def decode_side(config: Config) -> int:
    """[px] the largest size any stage asks for."""
    structure = config.structure
    return max(
        config.sources.decode_max_side, structure.coarse_max_side, structure.fine_max_side, structure.max_side or 0
    )


def _matched(run: Run, photos: Photos) -> tuple[Prior, Pairs, Matches]:
    config, reporter, threads, seed = run.config, run.reporter, run.threads, run.config.run.seed
    extra = read_extra_pairs(config.pairing.extra_file, photos.names)
    cache = FeatureCache(run.workspace.cache / "features")
    prior = run.stage(
        COARSE,
        [PHOTOS],
        lambda folder, scratch: make_prior(
            config.structure, photos, wanted=config.run.prior,
            scratch=scratch, reporter=reporter, threads=threads, seed=seed, cache=cache,
        ),
        Prior.load,
        source_key=prior_fingerprint(config.run.prior),
    )  # fmt: skip
    pairs = run.stage(
        PAIRS,
        [COARSE],
        lambda folder, scratch: candidate_pairs(config.pairing, prior, extra=extra, reporter=reporter, threads=threads),
        Pairs.load,
        source_key=digest(extra.tolist()) if len(extra) else "",
    )
    matches = run.stage(
        MATCHES,
        [PHOTOS, COARSE, PAIRS],
        lambda folder, scratch: match_pairs(
            config.structure, photos, pairs, prior,
            scratch=scratch, reporter=reporter, threads=threads, seed=seed, cache=cache,
            earlier=run.workspace.cache / MATCHES.folder,
        ),
        Matches.load,
    )  # fmt: skip
    return prior, pairs, matches


def _viewed(
    run: Run,
    photos: Photos,
    structure: Structure,
    prior: Prior | None,
    pairs: Pairs | None,
    matches: Matches | None,
    held: HeldPoses | None,
) -> Posed:
    for caution in structure.cautions:  # of a reused structure as well
        run.reporter.warn(caution)
    if structure.origin != AT_ZERO:
        run.reporter.info(describe(structure.origin))
    model = structure.reconstruction
    views = run.stage(
        VIEWS,
        [PHOTOS, MAPPING],
        lambda folder, scratch: undistort(
            run.config.structure, photos, model, folder, reporter=run.reporter, threads=run.threads
        ),
        Views.load,
    )
    graph = run.stage(
        GRAPH,
        [PHOTOS, PAIRS, MAPPING],
        lambda folder, scratch: build_camera_graph(
            model, views.is_test, structure.edges, structure.inliers, kinds=_kinds(model.names, structure.edges, pairs)
        ),
        CameraGraph.load,
    )
    return Posed(photos, structure, views, graph, prior, pairs, matches, held)


def _kinds(names: tuple[str, ...], edges: np.ndarray, pairs: Pairs | None) -> np.ndarray | None:
    """[E] uint8: why each verified pair was a candidate; 0 where it came later, as a bridge."""
    if pairs is None:
        return None
    bits = {
        tuple(sorted((pairs.names[i], pairs.names[j]))): k for (i, j), k in zip(pairs.pairs, pairs.kinds, strict=True)
    }
    return np.array([bits.get(tuple(sorted((names[i], names[j]))), 0) for i, j in edges], dtype=np.uint8)
