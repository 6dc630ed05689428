"""One training step: render, loss, backward, update. 13,600 Gaussians at 270 x 480, consistency off."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import torch

from bench import threads
from bench.metrics import Metric
from bench.scenes import scene
from bench.timing import median_time, time_metrics
from graphgs.graph import CameraGraph
from graphgs.rendering.splats import Splats
from graphgs.scene.views import Views
from graphgs.training.config import TrainConfig
from graphgs.training.trainer import Trainer

GAUSSIANS = 13_600
CAMERAS = 8
STEPS, AT_STEP = 2000, 1500  # past the last change of degree and of the number of Gaussians


@contextmanager
def trainer(device: str) -> Iterator[Trainer]:
    """A trainer in the middle of a short run."""
    load = scene("10k")
    rows = torch.arange(GAUSSIANS) % len(load.means)
    splats = Splats(
        means=load.means[rows],
        quats=load.quats[rows],
        log_scales=load.scales[rows].log(),
        logit_opacities=torch.logit(load.opacities[rows].clamp(1e-4, 0.999)),
        sh_coeffs=load.sh_coeffs[rows].contiguous(),
    ).to(device)
    rng = np.random.default_rng(0)
    viewmats = np.tile(load.viewmats[0].numpy().astype(np.float64), (CAMERAS, 1, 1))
    viewmats[:, :3, 3] += 0.01 * rng.standard_normal((CAMERAS, 3))
    names = tuple(f"{k}.png" for k in range(CAMERAS))
    is_test = np.zeros(CAMERAS, dtype=bool)
    edges = np.array([(i, i + 1) for i in range(CAMERAS - 1)])
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            blurred = cv2.GaussianBlur(rng.random((load.height, load.width, 3)), (0, 0), 5)
            cv2.imwrite(str(Path(folder) / name), (255 * blurred).astype(np.uint8))
        views = Views(
            folder=Path(folder),
            names=names,
            images=names,
            masks=(None,) * CAMERAS,
            sizes=np.tile([load.width, load.height], (CAMERAS, 1)),
            Ks=np.tile(load.Ks[0].numpy().astype(np.float64), (CAMERAS, 1, 1)),
            viewmats=viewmats,
            is_test=is_test,
        )
        rotations = viewmats[:, :3, :3]
        graph = CameraGraph(names, rotations, views.centers, edges, np.full(len(edges), 50), is_test)
        config = TrainConfig(steps=STEPS, consistency="none")
        running = Trainer(config, views, graph, splats, extent=1.0, device=device, seed=0)
        running.done = AT_STEP
        try:
            yield running
        finally:
            running.close()


def run(device: str) -> list[Metric]:
    metrics = []
    with trainer(device) as running:
        for count in threads.counts(device):
            with threads.use_threads(count):
                timing = median_time(running.step, repeats=30, warmup=5, device=device)
            metrics += time_metrics(f"step/13.6k/{threads.label(count)}", timing)
    return metrics
