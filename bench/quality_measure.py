"""One training and its judgement: everything a table says of a case, a set and a seed."""

import dataclasses
import statistics
import tempfile
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch

from bench.quality_cases import Case, rated
from bench.quality_inputs import Inputs, inputs_of
from bench.quality_scenes import Scene, load_scene
from bench.timing import median_ms
from graphgs.config import Config, preset, with_settings
from graphgs.evaluation.evaluate import evaluate
from graphgs.progress import Reporter
from graphgs.rendering.splats import Splats, render
from graphgs.scene.views import Views
from graphgs.training import train
from graphgs.training.trained import Trained
from tests.support.disturbed_poses import pose_errors

SHOWN = {"full": "full", "plain tuned": "plain"}  # cases whose renders of a synthetic view are kept, of the first seed


@dataclass(frozen=True)
class Job:
    """Picklable: it is carried to a worker process."""

    case: Case
    set: str
    scene: str
    seed: int
    steps: int
    rates: tuple[float, float]
    cache: Path
    device: str
    threads: int


def measure(job: Job) -> dict:
    """Train and judge; a row of the results."""
    scene = load_scene(job.cache, job.scene)
    config = training_config(job)
    with tempfile.TemporaryDirectory(prefix="graphgs-quality-") as scratch:
        inputs = inputs_of(job.case, scene, Path(scratch) / "photos")
        start = time.process_time()  # on a CPU its own seconds, which what else runs there hardly changes
        trained = train(
            config, inputs.views, inputs.graph, inputs.points, surfaces=inputs.dense,
            scratch=Path(scratch) / "checkpoints", device=job.device, seed=job.seed, threads=job.threads,
        )  # fmt: skip
        seconds = trained.stats.seconds if job.device != "cpu" else time.process_time() - start
        judged = evaluate(
            trained.splats, inputs.views, Path(scratch) / "eval",
            device=job.device, threads=1, reporter=Reporter(),
        )  # fmt: skip
        _keep_pictures(job, judged, Path(scratch) / "eval")
    worst = min(judged.views, key=lambda view: view.psnr)
    row = {
        "set": job.set, "case": job.case.name, "seed": job.seed, "steps": trained.stats.steps_executed,
        "rates": list(job.rates), "points": len(inputs.points.positions),
        "photos": len(inputs.views.names), "edges": len(inputs.graph.edges),
        "psnr": judged.psnr, "ssim": judged.ssim, "worst": worst.psnr, "worst_view": worst.name,
        "views": len(judged.views), "missing": len(judged.missing), "psnr_fitted": judged.psnr_exposure_fitted,
        "splats": len(trained.splats), "seconds": seconds, "dense_s": inputs.dense_s,
        "frames_per_s": _frames_per_s(trained.splats.to(job.device), inputs.views, job.device),
        "depth_error": _depth_error(trained.splats.to(job.device), scene, inputs.views),
    }  # fmt: skip
    if job.case.disturbed:
        row |= _pose_errors(scene, inputs, trained)
    return {k: round(v, 5) if isinstance(v, float) else v for k, v in row.items()}


def training_config(job: Job):
    """The preview preset with the case's settings."""
    settings = [f"training.{name}={value}" for name, value in job.case.training.items()]
    config = with_settings(preset("preview", Config()), settings).training
    rates = rated(dataclasses.asdict(config), job.rates)
    return dataclasses.replace(config, steps=job.steps, checkpoint_s=1e9, **rates)


def _frames_per_s(splats: Splats, views: Views, device: str) -> float:
    """Of rendering alone, at the size of the held-out views."""
    spent = []
    for i in np.flatnonzero(views.is_test)[:5]:
        size = tuple(int(side) for side in views.sizes[i])
        camera = (views.Ks[i], views.viewmats[i])
        with torch.no_grad():
            draw = partial(render, splats, *camera, *size)
            spent.append(median_ms(draw, repeats=5, warmup=1, device=device))
    return 1e3 / statistics.mean(spent)


def _depth_error(splats: Splats, scene: Scene, views: Views) -> float | None:
    """Median over all pixels with a true depth of |rendered - true| / true, held-out views, mean over the views; a
    pixel where nothing is rendered is off by all of it. None without a truth."""
    if scene.true_depths is None:
        return None
    errors = []
    for i in np.flatnonzero(views.is_test):
        truth = scene.true_depths.get(views.names[i])
        if truth is None:
            continue
        with torch.no_grad():
            size = tuple(int(side) for side in views.sizes[i])
            depth = render(splats, views.Ks[i], views.viewmats[i], *size).depths[0, ..., 0].cpu().numpy()
        seen = truth > 0
        errors.append(float(np.median(np.abs(depth[seen] - truth[seen]) / truth[seen])))
    return float(np.mean(errors)) if errors else None


def _pose_errors(scene: Scene, inputs: Inputs, trained: Trained) -> dict[str, float]:
    """Before and after training, of the training views against the poses before they were disturbed."""
    training = ~inputs.views.is_test
    truth = scene.views.viewmats[training]
    after = inputs.views.viewmats if trained.viewmats is None else trained.viewmats
    before, after = (pose_errors(poses[training], truth) for poses in (inputs.views.viewmats, after))
    return {
        "turn_before_deg": before[0], "shift_before": before[1], "turn_after_deg": after[0], "shift_after": after[1],
    }  # fmt: skip


def _keep_pictures(job: Job, judged, folder: Path) -> None:
    """Truth and render of two held-out views of the synthetic set, for the report."""
    if job.set != "street" or job.seed != 0 or job.case.name not in SHOWN:
        return
    target = job.cache / "quality" / "pictures"
    target.mkdir(parents=True, exist_ok=True)
    for where, view in (("ahead", judged.views[1]), ("aside", judged.views[len(judged.views) // 2])):
        for source, name in ((view.truth, "truth"), (view.render, SHOWN[job.case.name])):
            (target / f"{where}-{name}.png").write_bytes((folder / source).read_bytes())
