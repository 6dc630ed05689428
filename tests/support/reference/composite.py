"""Compositing of projected splats written for reading: every splat over every pixel; torch derives the gradient."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Composite:
    colors: Tensor  # [C, H * W, D]
    alphas: Tensor  # [C, H * W]
    depths: Tensor  # [C, H * W]
    median_depths: Tensor  # [C, H * W]


def composite(
    means2d: Tensor,  # [C, H * W, N, 2]: a pixel's own copy each, so that its share of the gradient can be told apart
    conics: Tensor,  # [C, N, 3]
    depths: Tensor,  # [C, N]
    opacities: Tensor,  # [C, N]
    colors: Tensor,  # [C, N, D]
    backgrounds: Tensor,  # [C, D]
    visible: Tensor,  # [C, N] bool
    masks: Tensor,  # [C, H * W] bool
    width: int,
) -> Composite:
    images = []
    for c in range(means2d.shape[0]):
        index = torch.arange(means2d.shape[1])
        pixels = torch.stack([index % width, index // width], -1) + 0.5
        light = torch.ones(len(index), dtype=means2d.dtype)
        color, depth_sum, median = torch.zeros(len(index), colors.shape[-1]).to(light), 0 * light, 0 * light
        stopped = ~masks[c]
        for s in torch.sort(depths[c], stable=True).indices:
            if not visible[c, s]:
                continue
            dx, dy = (pixels - means2d[c, :, s]).unbind(-1)
            sigma = 0.5 * (conics[c, s, 0] * dx**2 + conics[c, s, 2] * dy**2) + conics[c, s, 1] * dx * dy
            alpha = (opacities[c, s] * torch.exp(-sigma)).clamp(max=0.99)
            shown = (alpha >= 1 / 255) & ~stopped
            behind = light * (1 - alpha)
            stopped = stopped | (shown & (behind <= 1e-4))
            taken = shown & ~stopped
            weight = torch.where(taken, alpha * light, 0.0)
            color = color + weight[:, None] * colors[c, s]
            depth_sum = depth_sum + weight * depths[c, s]
            median = torch.where(taken & (light > 0.5) & (behind <= 0.5), depths[c, s], median)
            light = torch.where(taken, behind, light)
        alpha_sum = 1 - light
        depth = torch.where(alpha_sum > 0, depth_sum / torch.where(alpha_sum > 0, alpha_sum, 1.0), 0.0)
        images.append((color + light[:, None] * backgrounds[c], alpha_sum, depth, median))
    return Composite(*(torch.stack(parts) for parts in zip(*images, strict=True)))
