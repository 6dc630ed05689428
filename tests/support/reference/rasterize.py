"""The rasterizer written for reading: every Gaussian over every pixel, in float64; torch derives the gradient."""

from dataclasses import dataclass

import torch
from torch import Tensor

from tests.support.reference.sh import sh_colors

ALPHA_MIN, ALPHA_MAX, LIGHT_MIN = 1 / 255, 0.99, 1e-4


@dataclass(frozen=True)
class Twin:
    """What the twin renders, as `RenderOutput` names it, and what it knows about each pixel."""

    colors: Tensor  # [C, H, W, D]
    alphas: Tensor  # [C, H, W, 1]
    depths: Tensor  # [C, H, W, 1]
    median_depths: Tensor | None  # [C, H, W, 1]
    doubtful: Tensor  # [C, H, W] bool: so near a threshold that single precision may decide otherwise
    walked: Tensor  # [C, H, W] how many Gaussians the pixel took
    shares: list[Tensor]  # per camera [N, P, 2]: the projected centres, a copy for each of the P pixels not masked

    def v_means2d(self) -> Tensor:  # [C, N, 2]
        """After backward: the gradient of the projected centres."""
        return torch.stack([share.grad.sum(dim=1) for share in self.shares])

    def absgrad(self) -> Tensor:  # [C, N, 2]
        """After backward: the sum over pixels of the absolute value of each pixel's share (AbsGS, Ye et al. 2024)."""
        return torch.stack([share.grad.abs().sum(dim=1) for share in self.shares])


def rasterize(
    means: Tensor,  # [N, 3]
    quats: Tensor,  # [N, 4] wxyz
    scales: Tensor,  # [N, 3]
    opacities: Tensor,  # [N]
    colors: Tensor,  # [N, D] or [N, K, 3]
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
    backgrounds: Tensor | None = None,  # [C, D]
    masks: Tensor | None = None,  # [C, H, W] bool; where False a pixel sees no Gaussian
    median_depth: bool = False,
    absgrad: bool = False,  # keep each pixel's share of the gradient of the projected centres
) -> Twin:
    size = (height, width)
    images, shares = [], []
    for c in range(viewmats.shape[0]):
        rotation, translation = viewmats[c, :3, :3], viewmats[c, :3, 3]
        points = means @ rotation.T + translation
        ids = torch.nonzero((points[:, 2] > near) & (points[:, 2] < far)).squeeze(1)
        ids = ids[torch.sort(points[ids, 2], stable=True).indices]  # front to back
        means2d, covariances = project(points[ids], quats[ids], scales[ids], rotation, Ks[c], width, height)
        blurred = covariances + eps2d * torch.eye(2).to(means)
        peaks = opacities[ids]
        if antialiased:
            ratio = determinants(covariances) / determinants(blurred)
            drawn = ratio > 0  # the square root has no gradient at 0
            peaks = torch.where(drawn, peaks * torch.where(drawn, ratio, 1.0).sqrt(), 0.0)
        shown = colors[ids]
        if sh_degree is not None:
            shown = sh_colors(shown, means[ids] + rotation.T @ translation, sh_degree)

        # Only the pixels that see Gaussians; the others keep the values of an empty image.
        seen = torch.ones(size, dtype=torch.bool) if masks is None else masks[c]
        py, px = torch.nonzero(seen, as_tuple=True)
        pixels = torch.stack([px, py], -1).to(means) + 0.5  # [P, 2]
        if absgrad:
            share = torch.zeros(len(means), len(pixels), 2).to(means).requires_grad_()
            share.grad = torch.zeros_like(share)
            shares.append(share)
            offsets = pixels - (means2d[:, None] + share[ids])
        else:
            offsets = pixels - means2d[:, None]
        parts = composite(offsets, invert(blurred), points[ids, 2], peaks, shown, median_depth)
        images.append([part.new_zeros(*size, *part.shape[1:]).index_put((py, px), part) for part in parts])

    color, alpha, depth, median, doubtful, walked = (torch.stack(part) for part in zip(*images, strict=True))
    if backgrounds is not None:
        color = color + (1 - alpha)[..., None] * backgrounds[:, None, None]
    return Twin(
        color, alpha[..., None], depth[..., None], median[..., None] if median_depth else None, doubtful, walked, shares
    )


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


def determinants(
    matrices: Tensor,  # [M, 2, 2]
) -> Tensor:  # [M]
    return matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0]


def invert(
    covariances: Tensor,  # [M, 2, 2] symmetric
) -> Tensor:  # [M, 3] upper triangles of the inverse
    triangle = torch.stack([covariances[:, 1, 1], -covariances[:, 0, 1], covariances[:, 0, 0]], -1)
    return triangle / determinants(covariances)[:, None]


def composite(
    offsets: Tensor,  # [M, P, 2] from the Gaussians, front to back, to the pixels
    conics: Tensor,  # [M, 3]
    depths: Tensor,  # [M]
    peaks: Tensor,  # [M] opacities at the projected centres
    colors: Tensor,  # [M, D]
    median_depth: bool,
) -> tuple[Tensor, ...]:  # colour [P, D] without background; alpha, depth, median depth, doubtful and walked [P]
    dx, dy = offsets.unbind(-1)
    a, b, c = (conics[:, k, None] for k in range(3))
    raw = peaks[:, None] * torch.exp(-(0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy))  # [M, P]
    alpha = raw.clamp(max=ALPHA_MAX)
    visible = alpha >= ALPHA_MIN

    # Light only falls, so a pixel has stopped where, with all visible Gaussians taken, too little would be left.
    with torch.no_grad():
        if_taken = torch.cumprod(1 - torch.where(visible, alpha, 0.0), dim=0)
    taken = visible & (if_taken > LIGHT_MIN)
    alpha = torch.where(taken, alpha, 0.0)
    start = torch.ones_like(alpha[:1]) if len(alpha) else alpha.new_ones(1, alpha.shape[1])
    light = torch.cat([start, torch.cumprod(1 - alpha, dim=0)])  # [M + 1, P] before and after each
    weights = alpha * light[:-1]

    alpha_sum = 1 - light[-1]
    covered = alpha_sum > 0
    depth = torch.where(covered, depths @ weights / torch.where(covered, alpha_sum, 1.0), 0.0)
    halving = (light[:-1] > 0.5) & (light[1:] <= 0.5)
    median = depths @ halving.to(depths)
    with torch.no_grad():
        doubtful = _doubtful(raw, torch.cat([start, if_taken[:-1]]), if_taken, taken, depths)
        if median_depth:
            doubtful = doubtful | _near(light, 0.5, 1e-5).any(dim=0)
    return weights.T @ colors, alpha_sum, depth, median, doubtful, taken.sum(dim=0)


def _near(values: Tensor, threshold: float, tolerance: float) -> Tensor:
    return (values / threshold - 1).abs() < tolerance


def _doubtful(
    raw: Tensor,  # [M, P] alpha before the clamp
    before: Tensor,  # [M, P] light
    behind: Tensor,  # [M, P] light, were all visible Gaussians taken
    taken: Tensor,  # [M, P]
    depths: Tensor,  # [M]
) -> Tensor:  # [P]
    """Where single precision may decide otherwise: sigma is good to about 1e-5, light to 1 / (1 - alpha) times that.

    The clamp at ALPHA_MAX moves no value, but switches a gradient off. Depths one rounding apart may change places.
    """
    reached = before > LIGHT_MIN
    threshold = _near(raw, ALPHA_MIN, 2e-5) | _near(raw, ALPHA_MAX, 2e-5)
    stop = _near(behind, LIGHT_MIN, 1e-4) & (raw >= ALPHA_MIN)
    gaps = torch.diff(depths) / depths[1:]
    close = (gaps > 0) & (gaps < 1e-6)
    swap = taken[:-1] & taken[1:] & close[:, None]
    return (reached & (threshold | stop)).any(dim=0) | swap.any(dim=0)
