"""The photometric loss, L1 and SSIM fused, forward and backward; beside it the float64 twin in torch."""

import torch

from bench import threads
from bench.losses import loss_metrics, twin_metrics
from bench.metrics import Metric
from graphgs.losses import photometric_loss
from tests.support.reference.ssim import photometric_loss as twin

SIZES = {"270x480": (270, 480), "1920x1080": (1920, 1080)}  # width, height
SSIM_WEIGHT = 0.2


def run(device: str) -> list[Metric]:
    metrics = []
    for name, (width, height) in SIZES.items():
        generator = torch.Generator().manual_seed(0)
        truth = torch.rand(1, height, width, 3, generator=generator)
        image = (truth + 0.1 * torch.randn(truth.shape, generator=generator)).clamp(0, 1)
        leaf, target = image.to(device, copy=True).requires_grad_(), truth.to(device)
        for count in threads.counts(device):
            key = f"ssim/{name}/{threads.label(count)}"
            with threads.use_threads(count):
                metrics += loss_metrics(
                    key, lambda leaf=leaf, target=target: photometric_loss(leaf, target), [leaf], device=device
                )
        if name == "270x480":  # the twin keeps 121 copies of the image
            exact = image.double().requires_grad_()
            kept = torch.ones(truth.shape[:3], dtype=torch.bool)
            slow = lambda: twin(exact, truth.double(), kept, SSIM_WEIGHT)  # noqa: B023, E731
            metrics += twin_metrics(key, metrics, slow, [exact])
    return metrics
