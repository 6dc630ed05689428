"""Spherical harmonics as the textbook writes them: real, Condon-Shortley sign, by explicit polynomials in x, y, z."""

from math import pi, sqrt

import torch
from torch import Tensor


def sh_basis(
    directions: Tensor,  # [..., 3] unit
) -> Tensor:  # [..., 16]
    x, y, z = directions.unbind(-1)
    bands = [
        sqrt(1 / (4 * pi)) * torch.ones_like(x),
        -sqrt(3 / (4 * pi)) * y,
        sqrt(3 / (4 * pi)) * z,
        -sqrt(3 / (4 * pi)) * x,
        sqrt(15 / (4 * pi)) * x * y,
        -sqrt(15 / (4 * pi)) * y * z,
        sqrt(5 / (16 * pi)) * (3 * z**2 - 1),
        -sqrt(15 / (4 * pi)) * x * z,
        sqrt(15 / (16 * pi)) * (x**2 - y**2),
        -sqrt(35 / (32 * pi)) * y * (3 * x**2 - y**2),
        sqrt(105 / (4 * pi)) * x * y * z,
        -sqrt(21 / (32 * pi)) * y * (5 * z**2 - 1),
        sqrt(7 / (16 * pi)) * z * (5 * z**2 - 3),
        -sqrt(21 / (32 * pi)) * x * (5 * z**2 - 1),
        sqrt(105 / (16 * pi)) * z * (x**2 - y**2),
        -sqrt(35 / (32 * pi)) * x * (x**2 - 3 * y**2),
    ]
    return torch.stack(bands, dim=-1)


def sh_colors(
    sh_coeffs: Tensor,  # [N, K, 3]
    directions: Tensor,  # [N, 3], any length
    degree: int,
) -> Tensor:  # [N, 3]
    used = (degree + 1) ** 2
    basis = sh_basis(torch.nn.functional.normalize(directions, dim=-1))[:, :used]
    return ((basis[..., None] * sh_coeffs[:, :used]).sum(dim=1) + 0.5).clamp(min=0)
