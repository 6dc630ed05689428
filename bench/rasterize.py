"""`rasterize`, forward and backward, projection and spherical harmonics included, at 270 x 480.

The yardstick is the plain shape, one thread per pixel on one CPU thread: it stays as it is and is timed in the same
run, so the ratio says what the fast shape gains on any machine, busy or not.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import graphgs
from bench.metrics import Metric
from bench.timing import median_ms
from graphgs.rendering import rasterize

RECORDED = Path(__file__).resolve().parents[2] / "shared" / "data" / "raster"
WIDTH, HEIGHT = 270, 480
SIZES = {"2k": 2_000, "10k": 10_000}
THREADS = (1, 2)


@dataclass(frozen=True)
class Workload:
    gaussians: list[Tensor]  # means, quats, scales, opacities, sh_coeffs
    viewmats: Tensor
    Ks: Tensor
    v_image: Tensor  # [1, H, W, 3]
    source: str

    def step(self, shape: str) -> None:
        for tensor in self.gaussians:
            tensor.grad = None
        out = rasterize(*self.gaussians, self.viewmats, self.Ks, WIDTH, HEIGHT, sh_degree=3, shape=shape)
        torch.autograd.backward(out.colors, self.v_image)


def recorded_workload(path: Path) -> Workload:
    scene = np.load(path)
    gaussians = [torch.from_numpy(scene[k]).requires_grad_() for k in ("means", "quats", "scales", "opacities", "sh")]
    view, K, v_image = (torch.from_numpy(scene[k])[None] for k in ("viewmat", "K", "v_image"))
    return Workload(gaussians, view, K, v_image, f"recorded scene {path.name}")


def procedural_workload(n: int) -> Workload:
    """Gaussians in front of a camera, sizes and opacities spread as in a trained scene."""
    rng = torch.Generator().manual_seed(0)
    focal = 350.0
    depth = 1 + 5 * torch.rand(n, generator=rng)
    x = (torch.rand(n, generator=rng) - 0.5) * 1.1 * WIDTH / focal * depth
    y = (torch.rand(n, generator=rng) - 0.5) * 1.1 * HEIGHT / focal * depth
    pixels = torch.exp(1.1 + 0.7 * torch.randn(n, 3, generator=rng))  # standard deviations as seen
    gaussians = [
        torch.stack([x, y, depth], -1),
        torch.randn(n, 4, generator=rng),
        pixels * depth[:, None] / focal,
        torch.rand(n, generator=rng) ** 0.7,
        0.3 * torch.randn(n, 16, 3, generator=rng),
    ]
    K = torch.tensor([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]])
    v_image = torch.randn(1, HEIGHT, WIDTH, 3, generator=rng)
    tensors = [tensor.requires_grad_() for tensor in gaussians]
    return Workload(tensors, torch.eye(4)[None], K[None], v_image, f"procedural scene, seed 0, {n} Gaussians")


def workload(name: str) -> Workload:
    path = RECORDED / f"scene_{name}.npz"
    return recorded_workload(path) if path.is_file() else procedural_workload(SIZES[name])


def run(device: str) -> list[Metric]:
    metrics = []
    torch_threads = torch.get_num_threads()
    for name in SIZES:
        load = workload(name)
        print(f"rasterize/{name}: {load.source}")
        _use_threads(1)
        yardstick = median_ms(lambda load=load: load.step("pixels"), repeats=3, warmup=1)
        metrics.append(Metric(f"rasterize/{name}/yardstick", yardstick, "ms", "lower", 0.5))
        for threads in THREADS:
            _use_threads(threads)
            elapsed = median_ms(lambda load=load: load.step("tiles"), repeats=20, warmup=3)
            label = f"rasterize/{name}/{threads} thread" + "s" * (threads > 1)
            metrics.append(Metric(label, elapsed, "ms", "lower", 0.25))
            metrics.append(Metric(f"{label}/speed-up", yardstick / elapsed, "x", "higher", 0.25))
    _use_threads(torch_threads)
    return metrics


def _use_threads(count: int) -> None:
    graphgs.set_num_threads(count)
    torch.set_num_threads(count)
