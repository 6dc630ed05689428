"""Rotations and covariances of Gaussians in torch, for the strategies that move or divide them."""

import torch
from torch import Tensor


def rotations(quats: Tensor) -> Tensor:
    """[N, 3, 3] from wxyz [N, 4] of any length."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rows = (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack(rows, dim=-1).reshape(-1, 3, 3)


def stretch(
    quats: Tensor,  # [N, 4] wxyz, any length
    scales: Tensor,  # [N, 3] standard deviations, world units
    vectors: Tensor,  # [N, 3]
) -> Tensor:
    """[N, 3] R diag(scales) v: standard normal vectors become draws from the Gaussians."""
    return torch.einsum("nij,nj->ni", rotations(quats), scales * vectors)


def apply_covariance(
    quats: Tensor,  # [N, 4] wxyz, any length
    scales: Tensor,  # [N, 3] standard deviations, world units
    vectors: Tensor,  # [N, 3]
) -> Tensor:
    """[N, 3] covariance times vector: R diag(scales^2) R^T v."""
    turned = rotations(quats)
    return torch.einsum("nij,nj->ni", turned, scales**2 * torch.einsum("nji,nj->ni", turned, vectors))
