"""`rasterize`, forward and backward, projection and spherical harmonics included.

Two yardsticks run beside it: the frozen plain kernel, one thread per pixel (bench/yardstick.py), and, on a tiny scene,
the float64 twin in torch. Ratios against something that never changes mean the same on any machine, busy or not.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from bench import threads
from bench.metrics import Metric
from bench.scenes import Scene, procedural, scene
from bench.timing import TOLERANCE, median_ms, median_time, time_metrics
from bench.yardstick import yardstick_hash
from bench.yardstick_step import yardstick_render
from graphgs.rendering import rasterize
from tests.support.reference.rasterize import rasterize as twin

SIZES = ("2k", "10k", "50k")
LARGE = ("500k", "1m")  # at 1920 x 1080, for a card


@dataclass(frozen=True)
class Work:
    """A scene on its device, with its gradients."""

    scene: Scene
    leaves: list[Tensor]
    viewmats: Tensor
    Ks: Tensor
    v_image: Tensor

    @staticmethod
    def on(device: str, load: Scene, dtype: torch.dtype = torch.float32) -> "Work":
        leaves = [leaf.detach().to(dtype).requires_grad_() for leaf in load.leaves(device)]
        return Work(load, leaves, *(t.to(device, dtype) for t in (load.viewmats, load.Ks, load.v_image)))

    def step(self, render: Callable) -> None:
        """Forward and backward."""
        for leaf in self.leaves:
            leaf.grad = None
        out = render(*self.leaves, self.viewmats, self.Ks, self.scene.width, self.scene.height, sh_degree=3)
        torch.autograd.backward(out if isinstance(out, Tensor) else out.colors, self.v_image)


def run(device: str) -> list[Metric]:
    metrics = []
    for name in SIZES if device == "cpu" else SIZES + LARGE:
        load = scene(name)
        print(f"rasterize/{name}: {load.source}")
        walls = []
        for count in threads.counts(device):
            with threads.use_threads(count):
                key = f"rasterize/{name}/{threads.label(count)}"
                metrics += against_yardstick(key, Work.on(device, load))
                walls.append(next(m.value for m in metrics if m.name == key))
        if len(walls) > 1:
            metrics.append(Metric(f"rasterize/{name}/scaling", walls[0] / walls[-1], "x", "higher", TOLERANCE))
    return metrics + against_twin(device)


def against_yardstick(key: str, work: Work) -> list[Metric]:
    device = work.v_image.device.type
    timing = median_time(lambda: work.step(rasterize), repeats=20, warmup=3, device=str(work.v_image.device))
    metrics = time_metrics(key, timing)
    if device == "cpu":
        yardstick = median_ms(lambda: work.step(yardstick_render), repeats=3, warmup=1)
        times = yardstick / timing.wall_ms
        frozen = yardstick_hash()
        metrics.append(Metric(f"{key}/times the yardstick", times, "x", "higher", TOLERANCE, yardstick=frozen))
    return metrics


def against_twin(device: str) -> list[Metric]:
    tiny = procedural(200, 64, 64, pixels=3.0)
    with threads.use_threads(1):
        ours, theirs = Work.on(device, tiny), Work.on("cpu", tiny, torch.float64)
        fast = median_ms(lambda: ours.step(rasterize), repeats=10, device=device)
        slow = median_ms(lambda: theirs.step(twin), repeats=3, warmup=1)
    return [Metric("rasterize/tiny/times the torch twin", slow / fast, "x", "higher", 0.5)]
