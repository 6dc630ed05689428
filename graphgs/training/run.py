"""The training stage: from initial points to Gaussians, through interruptions."""

import dataclasses
import hashlib
import json
import math
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch

from graphgs.errors import DataError
from graphgs.graph import CameraGraph
from graphgs.points import DenseCloud, PrunedPoints
from graphgs.progress import Reporter
from graphgs.rendering.splats import Splats
from graphgs.scene.views import Views
from graphgs.threads import get_num_threads, set_num_threads
from graphgs.training.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from graphgs.training.config import TrainConfig
from graphgs.training.extent import scene_extent
from graphgs.training.near import near_depths
from graphgs.training.plateau import has_settled
from graphgs.training.sky import with_sky
from graphgs.training.stats import TrainStats
from graphgs.training.trained import Trained
from graphgs.training.trainer import Trainer

READ_INTERVAL = 10  # steps between two looks at the losses (on a GPU each look waits for it)
CHECK_INTERVAL = 100  # steps between two looks at all values
RECOVERY_INTERVAL = 500  # steps between two states to roll back to: by steps, so that a roll-back is repeatable
VERSION = 2  # of the checkpoint's meaning; raise it when a step changes
RUNNING = ("image_cache_bytes", "checkpoint_s")  # settings without influence on the result


def train(
    config: TrainConfig,
    views: Views,
    graph: CameraGraph,
    points: PrunedPoints,
    *,
    surfaces: DenseCloud | None = None,  # what the depth loss compares with; None: there is none
    scratch: Path,  # checkpoints; a later call with the same arguments goes on from here
    device: str = "cpu",
    seed: int = 0,
    threads: int | None = None,  # None = as set by graphgs.set_num_threads
    reporter: Reporter | None = None,
    stop_at: int | None = None,  # save and return after this many executed steps: one slice of a run
) -> Trained:
    """Optimise Gaussians on the training views (3DGS, Kerbl et al. 2023, guided by the camera graph).

    Exposures and poses, if they are fitted, are those of training views: no test photo is read here.
    On the CPU the result is bit-identical for any `threads` and any interruption. Saves and re-raises on
    KeyboardInterrupt. Raises DataError without points or training views, for cameras that are not finite, or when
    training diverges twice."""
    reporter = reporter or Reporter()
    if views.is_test.all():
        raise DataError("training: no view is left to train on", hint="at least one photo must not be a test view")
    _check_cameras(views)
    with _threads(threads), _deferred_interrupt() as interrupted:
        extent = scene_extent(views.centers[~views.is_test], points.positions)
        start = points
        if config.sky == "sphere":
            start = with_sky(
                points, views, count=config.sky_points, extent=extent, budget_bytes=config.image_cache_bytes
            )
            reporter.event("sky", gaussians=len(start.positions) - len(points.positions))
        initial = _initial(config, start, device=device, reporter=reporter)
        depths = near_depths(views, points.positions)
        trainer = Trainer(
            config, views, graph, initial,
            extent=extent, near_depths=depths, device=device, seed=seed, surfaces=surfaces,
        )  # fmt: skip
        try:
            run = _Run(trainer, scratch, _fingerprint(config, views, graph, initial, surfaces, device, seed), reporter)
            run.advance(config.steps if stop_at is None else min(stop_at, config.steps), interrupted)
        finally:
            trainer.close()
        return Trained(trainer.splats(), run.stats, *trainer.fits())


class _Run:
    """A trainer with its checkpoints, its guard against values that are not finite, and its reports."""

    def __init__(self, trainer: Trainer, scratch: Path, fingerprint: str, reporter: Reporter):
        self._trainer, self._scratch, self._fingerprint = trainer, scratch, fingerprint
        self._reporter = reporter
        self.stats = TrainStats(num_splats=len(trainer.parameters))
        self._unread: list[torch.Tensor] = []  # losses since the last look
        self._clock = time.perf_counter()
        if (checkpoint := load_checkpoint(scratch, "latest", fingerprint)) is not None:
            self._restore(checkpoint)
            reporter.event("resumed", step=checkpoint.step)
        else:
            self._save("recovery")
            self._save("latest")
        self._saved_at = time.perf_counter()

    def advance(self, end: int, interrupted: threading.Event) -> None:
        """Execute steps up to `end`; a state that is not finite is never saved."""
        trainer = self._trainer
        try:
            while trainer.done < end and not self._has_settled():
                self._unread.append(trainer.step())
                self._after_step(end)
                if interrupted.is_set():
                    raise KeyboardInterrupt
        except KeyboardInterrupt:
            if trainer.between_steps and self._is_finite():
                self._save("latest")
            raise
        if self._saved_step != trainer.done:
            self._save("latest")

    def _has_settled(self) -> bool:
        settled = has_settled(self._trainer.config, self._trainer.schedule, self.stats.curve)
        if settled:
            self._reporter.event("settled", step=self._trainer.done)
        return settled

    def _after_step(self, end: int) -> None:
        trainer, done = self._trainer, self._trainer.done
        if done % READ_INTERVAL and done != end:
            return
        if not self._is_finite(values=done % CHECK_INTERVAL == 0 or done == end):
            self._recover()
            return
        if done % READ_INTERVAL == 0:
            self._report()
        if done % RECOVERY_INTERVAL == 0 and self._is_finite():
            self._save("recovery")
        if time.perf_counter() - self._saved_at >= trainer.config.checkpoint_s and self._is_finite():
            self._save("latest")

    def _is_finite(self, *, values: bool = True) -> bool:
        if self._unread and not bool(torch.isfinite(torch.stack(self._unread).sum())):
            return False
        return not values or self._trainer.is_sound

    def _report(self) -> None:
        trainer, stats = self._trainer, self.stats
        self._tick()
        loss = math.fsum(torch.stack(self._unread).tolist()) / len(self._unread)
        self._unread.clear()
        seconds = round(stats.seconds, 3)
        entry = {"step": trainer.done, "loss": loss, "num_splats": len(trainer.parameters), "seconds": seconds}
        previous = stats.curve[-1]["seconds"] if stats.curve else 0.0
        stats.curve.append(entry)
        self._reporter.progress(trainer.done, trainer.config.steps, f"loss {loss:.4f}, {entry['num_splats']} Gaussians")
        if trainer.done % CHECK_INTERVAL == 0:
            step_ms = 1e3 * (seconds - previous) / READ_INTERVAL
            self._reporter.event("train", **entry, step_ms=round(step_ms, 2))

    def _recover(self) -> None:
        """Roll back to the last good state and go on more carefully; stop the second time."""
        trainer = self._trainer
        view = trainer.views.names[trainer.view_of_step(trainer.done - 1)]
        checkpoint = load_checkpoint(self._scratch, "recovery", self._fingerprint)
        if trainer.recoveries > 0 or checkpoint is None:
            raise DataError(
                f"training: values are not finite near step {trainer.done} (view {view}), also after a roll-back",
                hint="the poses or the images may be wrong: look at the reprojection in the report, or lower the rates",
            )
        self._reporter.warn(
            f"training diverged near step {trainer.done} (view {view}); "
            f"going on from step {checkpoint.step} with halved learning rates"
        )
        self._restore(checkpoint)
        trainer.recoveries = self.stats.recoveries = 1
        self._save("latest")

    def _save(self, name: str) -> None:
        self._tick()
        trainer = self._trainer
        self.stats.steps_executed, self.stats.num_splats = trainer.done, len(trainer.parameters)
        losses = torch.stack(self._unread).tolist() if self._unread else []
        extra = {"stats": dataclasses.asdict(self.stats), "unread": losses, "recoveries": trainer.recoveries}
        save_checkpoint(Checkpoint(trainer.done, trainer.state(), extra, self._fingerprint), self._scratch, name)
        if name == "latest":
            self._saved_step, self._saved_at = trainer.done, time.perf_counter()

    def _restore(self, checkpoint: Checkpoint) -> None:
        trainer = self._trainer
        trainer.restore(checkpoint.step, checkpoint.tensors)
        trainer.recoveries = int(checkpoint.extra["recoveries"])
        self.stats = TrainStats(**checkpoint.extra["stats"])
        self._unread = [torch.tensor(loss, device=trainer.device) for loss in checkpoint.extra["unread"]]
        self._saved_step = checkpoint.step
        self._clock = time.perf_counter()

    def _tick(self) -> None:
        now = time.perf_counter()
        self.stats.seconds += now - self._clock
        self._clock = now


def _initial(config: TrainConfig, points: PrunedPoints, *, device: str, reporter: Reporter) -> Splats:
    splats = Splats.from_points(points, initial_opacity=config.initial_opacity, device=device)
    if len(splats) > config.max_splats:
        reporter.warn(f"{len(splats)} initial points exceed max_splats = {config.max_splats}; an even share is used")
        rows = np.linspace(0, len(splats) - 1, config.max_splats).round().astype(np.int64)
        splats = splats.rows(torch.from_numpy(rows).to(device))
    return dataclasses.replace(splats, sh_degree=config.sh_degree)


def _check_cameras(views: Views) -> None:
    finite = np.isfinite(views.viewmats).all(axis=(1, 2)) & np.isfinite(views.Ks).all(axis=(1, 2))
    if not finite.all():
        broken = [name for name, good in zip(views.names, finite, strict=True) if not good]
        raise DataError(
            f"training: the cameras of {len(broken)} views are not finite: {', '.join(broken[:3])}",
            hint="the given poses may be damaged; without them, poses are found from the photos",
        )


def _fingerprint(
    config: TrainConfig,
    views: Views,
    graph: CameraGraph,
    initial: Splats,
    surfaces: DenseCloud | None,
    device: str,
    seed: int,
) -> str:
    """Of everything the result depends on: a checkpoint of anything else is not continued."""
    settings = {k: v for k, v in dataclasses.asdict(config).items() if k not in RUNNING}
    plain = [VERSION, settings, seed, torch.device(device).type, views.names, views.images, graph.names]
    digest = hashlib.sha256(json.dumps(plain).encode())
    arrays = [
        views.sizes,
        views.Ks,
        views.viewmats,
        views.is_test,
        graph.sampling_probability(measure=config.importance),
    ]
    arrays += [graph.targets(mode=config.consistency), graph.edges] if config.consistency != "none" else []
    arrays += [tensor.cpu().numpy() for tensor in (initial.means, initial.log_scales, initial.sh_coeffs)]
    arrays += [surfaces.positions, surfaces.views] if surfaces is not None and config.lambda_depth > 0.0 else []
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


@contextmanager
def _threads(count: int | None) -> Iterator[None]:
    """Kernels use `count` threads; torch one, because its sums depend on how many share the work."""
    kernels, torch_threads = get_num_threads(), torch.get_num_threads()
    set_num_threads(count or kernels)
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(torch_threads)
        set_num_threads(kernels)


@contextmanager
def _deferred_interrupt() -> Iterator[threading.Event]:
    """The first Ctrl-C waits for the end of the step; a second one acts at once."""
    interrupted = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield interrupted  # only the main thread receives signals
        return
    previous = signal.getsignal(signal.SIGINT)

    def note(number: int, frame) -> None:
        interrupted.set()
        signal.signal(signal.SIGINT, previous)

    signal.signal(signal.SIGINT, note)
    try:
        yield interrupted
    finally:
        signal.signal(signal.SIGINT, previous)
