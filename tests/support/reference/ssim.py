"""SSIM and the photometric loss in float64 torch, one window at a time: the definition, written for reading."""

import torch
from torch import Tensor
from torch.nn.functional import pad


def window() -> Tensor:  # [11, 11], sum 1
    offsets = torch.arange(-5, 6, dtype=torch.float64)
    weights = torch.exp(-0.5 * (offsets / 1.5) ** 2)
    weights = weights / weights.sum()
    return weights[:, None] * weights[None, :]


def windowed(image: Tensor) -> Tensor:  # [C, H, W, 3] -> the weighted mean around each pixel, zero beyond the rim
    height, width = image.shape[1:3]
    padded = pad(image, (0, 0, 5, 5, 5, 5))
    weights = window()
    return sum(weights[v, u] * padded[:, v : v + height, u : u + width] for v in range(11) for u in range(11))


def ssim_map(a: Tensor, b: Tensor) -> Tensor:  # [C, H, W, 3] each
    c1, c2 = 0.01**2, 0.03**2
    mean_a, mean_b = windowed(a), windowed(b)
    variance_a = windowed(a * a) - mean_a**2
    variance_b = windowed(b * b) - mean_b**2
    covariance = windowed(a * b) - mean_a * mean_b
    luminance = (2 * mean_a * mean_b + c1) / (mean_a**2 + mean_b**2 + c1)
    structure = (2 * covariance + c2) / (variance_a + variance_b + c2)
    return luminance * structure


def photometric_loss(image: Tensor, truth: Tensor, kept: Tensor, ssim_weight: float) -> Tensor:
    """`kept`: [C, H, W] bool."""
    image = torch.where(kept[..., None], image, truth)
    error = (image - truth).abs()[kept].mean()
    similarity = ssim_map(image, truth)[kept].mean()
    return (1 - ssim_weight) * error + ssim_weight * (1 - similarity)
