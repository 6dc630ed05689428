"""Reprojection and the consistency losses of one pair in float64 torch, step by step, differentiable by autograd."""

import torch
from torch import Tensor


def pixel_centres(height: int, width: int) -> Tensor:  # [H, W, 2]
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return torch.stack([x, y], dim=-1).double() + 0.5


def reproject(depth: Tensor, K_i: Tensor, K_j: Tensor, cam_j_from_cam_i: Tensor) -> tuple[Tensor, Tensor]:
    """[H, W] depth -> pixel coordinates in image j [H, W, 2], depth in camera j [H, W]."""
    pixels = pixel_centres(*depth.shape)
    rays = torch.cat([pixels, torch.ones_like(pixels[..., :1])], dim=-1) @ torch.linalg.inv(K_i).T
    points_i = rays * depth[..., None]
    points_j = points_i @ cam_j_from_cam_i[:3, :3].T + cam_j_from_cam_i[:3, 3]
    projected = points_j @ K_j.T
    return projected[..., :2] / projected[..., 2:], points_j[..., 2]


def inside(coords: Tensor, height: int, width: int) -> Tensor:
    x, y = coords.unbind(-1)
    return (x >= 0.5) & (y >= 0.5) & (x <= width - 0.5) & (y <= height - 0.5)


def sample(image: Tensor, coords: Tensor) -> Tensor:  # [H, W, D] at [..., 2] px, bilinear; coords inside
    height, width = image.shape[:2]
    x, y = (coords - 0.5).unbind(-1)
    x0 = x.detach().floor().long().clamp(0, max(width - 2, 0))
    y0 = y.detach().floor().long().clamp(0, max(height - 2, 0))
    x1, y1 = (x0 + 1).clamp(max=width - 1), (y0 + 1).clamp(max=height - 1)
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    upper = image[y0, x0] * (1 - fx) + image[y0, x1] * fx
    lower = image[y1, x0] * (1 - fx) + image[y1, x1] * fx
    return upper * (1 - fy) + lower * fy


def matches(depth_i, alpha_i, depth_j, coords, depths, *, min_alpha=0.5, tolerance=0.05) -> Tensor:  # [H, W] bool
    valid = (depth_i > 0) & (alpha_i >= min_alpha) & (depths > 0) & inside(coords, *depth_j.shape)
    somewhere = torch.where(valid[..., None], coords, torch.full_like(coords, 0.5))
    seen = sample(depth_j[..., None], somewhere)[..., 0]
    touches_nothing = sample((depth_j <= 0).double()[..., None], somewhere)[..., 0] == 0
    return valid & touches_nothing & ((seen - depths).abs() <= tolerance * depths)


def consistency_loss(image_i, depth_i, alpha_i, image_j, depth_j, K_i, K_j, cam_j_from_cam_i, *, mode) -> Tensor:
    """Images [H, W, 3]; depths and alpha [H, W]."""
    if mode == "paper":
        coords, depths = reproject(torch.ones_like(depth_i), K_i, K_j, cam_j_from_cam_i)
        valid = (depths > 0) & inside(coords, *image_j.shape[:2])
        return (image_i[valid] - sample(image_j, coords[valid])).abs().mean()
    coords, depths = reproject(depth_i, K_i, K_j, cam_j_from_cam_i)
    valid = matches(depth_i, alpha_i, depth_j, coords.detach(), depths.detach())
    errors = image_i[valid] - sample(image_j, coords[valid])
    return (torch.sqrt(errors**2 + 1e-6) - 1e-3).mean()
