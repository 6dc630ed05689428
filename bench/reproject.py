"""The consistency loss of one pair of views, forward and backward; beside it the float64 twin in torch."""

import torch
from torch import Tensor

from bench import threads
from bench.losses import loss_metrics, twin_metrics
from bench.metrics import Metric
from graphgs.losses import consistency_loss
from tests.support.reference.reproject import consistency_loss as twin

SIZES = {"270x480": (270, 480), "1920x1080": (1920, 1080)}  # width, height
DEPTH = 4.0  # of a wall that both cameras face


def run(device: str) -> list[Metric]:
    metrics = []
    for name, (width, height) in SIZES.items():
        operands = wall(width, height)
        here = [t.to(device, torch.float32) for t in operands]
        leaves = [t.requires_grad_() for t in here[:2]]
        for count in threads.counts(device):
            key = f"reproject/{name}/{threads.label(count)}"
            with threads.use_threads(count):
                metrics += loss_metrics(
                    key, lambda here=here: consistency_loss(*here, mode="graphgs"), leaves, device=device
                )
        flat = [t[..., 0] if t.shape[-1] == 1 else t for t in operands]
        exact = [t.requires_grad_() for t in flat[:2]]
        metrics += twin_metrics(key, metrics, lambda flat=flat: twin(*flat, mode="graphgs"), exact)
    return metrics


def wall(width: int, height: int) -> list[Tensor]:
    """Arguments of `consistency_loss`, float64: noise seen by two cameras, one a step beside the other."""
    generator = torch.Generator().manual_seed(0)
    focal = 0.75 * max(width, height)
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float64)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, 3] = torch.tensor([0.1, 0.02, 0.05])
    images = torch.rand(2, height, width, 3, generator=generator, dtype=torch.float64)
    depth_i = torch.full((height, width, 1), DEPTH, dtype=torch.float64)
    return [images[0], depth_i, torch.ones_like(depth_i), images[1], depth_i + 0.05, K, K, pose]
