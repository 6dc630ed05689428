"""The rasterizer written for reading: every Gaussian over every pixel, in turn; torch derives the gradient."""

import torch
from torch import Tensor

from tests.support.reference.sh import sh_colors


def rasterize(
    means: Tensor,  # [N, 3]
    quats: Tensor,  # [N, 4] wxyz
    scales: Tensor,  # [N, 3]
    opacities: Tensor,  # [N]
    colors: Tensor,  # [N, 3] or [N, K, 3]
    viewmats: Tensor,  # [C, 4, 4]
    Ks: Tensor,  # [C, 3, 3]
    width: int,
    height: int,
    *,
    sh_degree: int | None = None,
    near: float = 0.01,
    far: float = 1e10,
    eps2d: float = 0.3,
    antialiased: bool = False,
    backgrounds: Tensor | None = None,  # [C, 3]
) -> tuple[Tensor, Tensor, Tensor]:  # colors [C, H, W, 3], alphas [C, H, W, 1], depths [C, H, W, 1]
    images = []
    for c in range(viewmats.shape[0]):
        rotation, translation = viewmats[c, :3, :3], viewmats[c, :3, 3]
        points = means @ rotation.T + translation
        kept = (points[:, 2] > near) & (points[:, 2] < far)
        ids = torch.arange(len(means))[kept]
        points = points[kept]
        means2d, covariances = project(points, quats[ids], scales[ids], rotation, Ks[c], width, height)
        blurred = covariances + eps2d * torch.eye(2, dtype=means.dtype)
        alphas_at_mean = opacities[ids]
        if antialiased:
            ratio = torch.linalg.det(covariances) / torch.linalg.det(blurred)
            alphas_at_mean = alphas_at_mean * ratio.clamp(min=0).sqrt()
        if sh_degree is None:
            rgb = colors[ids]
        else:
            rgb = sh_colors(colors[ids], means[ids] + rotation.T @ translation, sh_degree)
        order = torch.sort(points[:, 2], stable=True).indices
        background = None if backgrounds is None else backgrounds[c]
        images.append(
            composite(
                means2d[order],
                torch.linalg.inv(blurred[order]),
                points[order, 2],
                alphas_at_mean[order],
                rgb[order],
                background,
                width,
                height,
            )
        )
    return tuple(torch.stack(parts) for parts in zip(*images, strict=True))


def project(
    points: Tensor,  # [M, 3] camera
    quats: Tensor,  # [M, 4]
    scales: Tensor,  # [M, 3]
    rotation: Tensor,  # [3, 3] camera-from-world
    K: Tensor,  # [3, 3]
    width: int,
    height: int,
) -> tuple[Tensor, Tensor]:  # [M, 2] px, [M, 2, 2] px^2
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    x, y, z = points.unbind(-1)
    # The Jacobian is taken no further out than 0.3 fields of view beyond the image.
    margin_x, margin_y = 0.3 * 0.5 * width / fx, 0.3 * 0.5 * height / fy
    slope_x = (x / z).clamp(-cx / fx - margin_x, (width - cx) / fx + margin_x)
    slope_y = (y / z).clamp(-cy / fy - margin_y, (height - cy) / fy + margin_y)
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [torch.stack([fx / z, zero, -fx * slope_x / z], -1), torch.stack([zero, fy / z, -fy * slope_y / z], -1)], -2
    )
    root = jacobian @ rotation @ rotation_matrices(quats) @ torch.diag_embed(scales)
    return torch.stack([fx * x / z + cx, fy * y / z + cy], -1), root @ root.transpose(-1, -2)


def rotation_matrices(
    quats: Tensor,  # [M, 4] wxyz; the zero quaternion is the identity
) -> Tensor:  # [M, 3, 3]
    length = quats.norm(dim=-1, keepdim=True)
    w, x, y, z = torch.where(length > 0, quats / length.clamp(min=1e-300), quats).unbind(-1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
    ]
    return torch.stack(rows, -2)


def composite(
    means2d: Tensor,  # [M, 2] front to back
    conics: Tensor,  # [M, 2, 2]
    depths: Tensor,  # [M]
    opacities: Tensor,  # [M]
    rgb: Tensor,  # [M, 3]
    background: Tensor | None,  # [3]
    width: int,
    height: int,
) -> tuple[Tensor, Tensor, Tensor]:
    px = torch.arange(width, dtype=means2d.dtype) + 0.5
    py = torch.arange(height, dtype=means2d.dtype) + 0.5
    pixels = torch.stack(torch.meshgrid(px, py, indexing="xy"), -1)  # [H, W, 2]
    light = torch.ones(height, width, dtype=means2d.dtype)
    color = torch.zeros(height, width, 3, dtype=means2d.dtype)
    depth_sum = torch.zeros_like(light)
    stopped = torch.zeros(height, width, dtype=torch.bool)
    for mean, conic, depth, opacity, shade in zip(means2d, conics, depths, opacities, rgb, strict=True):
        offset = pixels - mean
        sigma = 0.5 * torch.einsum("hwi,ij,hwj->hw", offset, conic, offset)
        alpha = (opacity * torch.exp(-sigma)).clamp(max=0.99)
        visible = (alpha >= 1 / 255) & ~stopped
        behind = light * (1 - alpha)
        stopped = stopped | (visible & (behind <= 1e-4))
        taken = visible & ~stopped
        weight = torch.where(taken, alpha * light, 0.0)
        color = color + weight[..., None] * shade
        depth_sum = depth_sum + weight * depth
        light = torch.where(taken, behind, light)
    alpha_sum = 1 - light
    covered = alpha_sum > 0
    depth = torch.where(covered, depth_sum / torch.where(covered, alpha_sum, 1.0), 0.0)
    if background is not None:
        color = color + light[..., None] * background
    return color, alpha_sum[..., None], depth[..., None]
