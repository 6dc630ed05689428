"""Multi-view consistency: view i, warped by its depth, against view j, in two forms.

`graphgs` (the product's default): back-project by the rendered depth, transform, project, sample, and compare where
both views see the same surface. `paper` is the printed term, |I_i(p) - I_j(K_j (R K_i^-1 p + T))|: it has no depth, so
it follows a ray of depth 1 and a translation in the reconstruction's units, and is right only for surfaces at depth 1.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from graphgs.kernels.reproject import DepthPair, compare_views, reproject_depth
from graphgs.losses.checks import as_real, check_images
from graphgs.rendering.bridge import scalars, torch_stream
from graphgs.threads import get_num_threads

Mode = Literal["graphgs", "paper"]

MIN_ALPHA = 0.5  # a fainter pixel's expected depth says little; our choice
DEPTH_TOLERANCE = 0.05  # of the depth; wide enough for early renders, far below a typical occlusion step; our choice


@dataclass(frozen=True)
class Reprojection:
    """Where the pixels of image i land in image j."""

    coords: Tensor  # [C, Hi, Wi, 2] px in image j; meaningless where not valid
    depths: Tensor  # [C, Hi, Wi, 1] in camera j
    valid: Tensor  # [C, Hi, Wi, 1] bool


def consistency_loss(
    image_i: Tensor,  # [Hi, Wi, 3] or [C, Hi, Wi, 3] for C pairs
    depth_i: Tensor,  # [.., Hi, Wi, 1] expected depth (camera z); 0 = nothing there
    alpha_i: Tensor,  # [.., Hi, Wi, 1] no gradient
    image_j: Tensor,  # [.., Hj, Wj, 3] float, or uint8; no gradient
    depth_j: Tensor,  # [.., Hj, Wj, 1] 0 = nothing there; no gradient
    K_i: Tensor,  # [3, 3] or [C, 3, 3] px; no gradient, as K_j and the pose
    K_j: Tensor,
    cam_j_from_cam_i: Tensor,  # [4, 4] or [C, 4, 4]
    *,
    mode: Mode,
    min_alpha: float = MIN_ALPHA,
    depth_tolerance: float = DEPTH_TOLERANCE,
) -> Tensor:  # scalar
    """Mean over the matched pixels (of all pairs, and over channels) of the colour difference; 0 where nothing matches.

    `graphgs`: robust L1 (Charbonnier, quadratic below 1e-3) over the pixels `reproject` calls valid; differentiable in
    `image_i` and, through the sampled colour, in `depth_i`. Every other pixel has a gradient of exactly zero. Depths
    and translation in any common unit give the same loss.
    `paper`: the printed geometry with plain L1, over the pixels that land inside image j; differentiable in `image_i`.
    The paper prints a sum over pixels, which would depend on the resolution; this is its mean.
    """
    image_i, depth_i, alpha_i, image_j, depth_j, K_i, K_j, cam_j_from_cam_i = _batched(
        image_i, depth_i, alpha_i, image_j, depth_j, K_i, K_j, cam_j_from_cam_i
    )
    check_images(image_i=image_i)
    _check_size("depth_i", depth_i, image_i)
    _check_size("depth_j", depth_j, image_j)
    pixel_map = _pixel_map(K_i, K_j, cam_j_from_cam_i, like=image_i)
    sums = _CompareViews.apply(
        image_i,
        depth_i.to(image_i.dtype),
        alpha_i.detach().to(image_i.dtype),
        as_real(image_j, image_i.dtype),
        depth_j.detach().to(image_i.dtype),
        pixel_map,
        _unit_depth(mode),
        image_i.new_tensor([min_alpha, depth_tolerance]),
    )
    return (sums[0] / (3 * sums[1].detach().clamp(min=1))).to(image_i.dtype)


def reproject(
    depth_i: Tensor,  # [Hi, Wi, 1] or [C, Hi, Wi, 1], camera z
    alpha_i: Tensor,
    depth_j: Tensor,  # [.., Hj, Wj, 1]
    K_i: Tensor,  # [3, 3] or [C, 3, 3] px
    K_j: Tensor,
    cam_j_from_cam_i: Tensor,  # [4, 4] or [C, 4, 4]
    *,
    mode: Mode = "graphgs",
    min_alpha: float = MIN_ALPHA,
    depth_tolerance: float = DEPTH_TOLERANCE,
) -> Reprojection:
    """Where the pixels of image i land in image j, without gradient.

    Valid: depth and depth in camera j positive, alpha at least `min_alpha`, between the centres of image j's outermost
    pixels, and not occluded: the depth image j has there agrees within `depth_tolerance` (relative, so free of scale).
    """
    depth_i, alpha_i, depth_j, K_i, K_j, cam_j_from_cam_i = _batched(
        depth_i, alpha_i, depth_j, K_i, K_j, cam_j_from_cam_i
    )
    depth_i = depth_i.detach().contiguous()
    pixel_map = _pixel_map(K_i, K_j, cam_j_from_cam_i, like=depth_i)
    coords = depth_i.new_empty((*depth_i.shape[:3], 2))
    depths, matched = torch.empty_like(depth_i), torch.empty_like(depth_i)
    limits = depth_i.new_tensor([min_alpha, depth_tolerance])
    alpha_i, depth_j = (t.detach().to(depth_i.dtype).contiguous() for t in (alpha_i, depth_j))
    with torch_stream(depth_i.device):
        pair = _depth_pair(depth_i, alpha_i, depth_j, pixel_map, _unit_depth(mode), limits)
        reproject_depth(pair, scalars(coords), scalars(depths), scalars(matched), threads=get_num_threads())
    return Reprojection(coords, depths, matched > 0)


class _CompareViews(torch.autograd.Function):
    """Sums of the residuals over matched pixels and channels, and of the matched pixels -> [2] float64."""

    @staticmethod
    def forward(ctx, image_i, depth_i, alpha_i, image_j, depth_j, pixel_map, unit_depth, limits):
        image_i, depth_i, alpha_i = image_i.contiguous(), depth_i.contiguous(), alpha_i.contiguous()
        image_j, depth_j = image_j.contiguous(), depth_j.contiguous()
        slopes_image, slopes_depth = torch.empty_like(image_i), torch.empty_like(depth_i)
        sums = torch.empty(2, dtype=torch.float64, device=image_i.device)
        with torch_stream(image_i.device):
            compare_views(
                _depth_pair(depth_i, alpha_i, depth_j, pixel_map, unit_depth, limits),
                scalars(image_i),
                scalars(image_j),
                scalars(slopes_image),
                scalars(slopes_depth),
                scalars(sums),
                threads=get_num_threads(),
            )
        ctx.save_for_backward(slopes_image, slopes_depth)
        return sums

    @staticmethod
    @once_differentiable
    def backward(ctx, v_sums):
        slopes = ctx.saved_tensors
        v_residual = v_sums[0].to(slopes[0].dtype)
        v_inputs = [v_residual * slope if ctx.needs_input_grad[k] else None for k, slope in enumerate(slopes)]
        return *v_inputs, *[None] * 6


def _depth_pair(depth_i, alpha_i, depth_j, pixel_map, unit_depth: bool, limits) -> DepthPair:
    return DepthPair(
        depth_i=scalars(depth_i),
        alpha_i=scalars(alpha_i),
        size_i=tuple(depth_i.shape[1:3]),
        depth_j=scalars(depth_j),
        size_j=tuple(depth_j.shape[1:3]),
        pixel_map=scalars(pixel_map),
        unit_depth=unit_depth,
        limits=scalars(limits),
    )


def _pixel_map(K_i: Tensor, K_j: Tensor, cam_j_from_cam_i: Tensor, *, like: Tensor) -> Tensor:  # [C, 12]
    """K_j R K_i^-1 row by row, then K_j T (kernels/reproject/geometry.py), computed in float64."""
    K_i, K_j, pose = (t.detach().to(like.device, torch.float64) for t in (K_i, K_j, cam_j_from_cam_i))
    # inv_ex: `inv` would wait for the GPU to look for singular matrices
    ray = K_j @ pose[:, :3, :3] @ torch.linalg.inv_ex(K_i)[0]
    shift = K_j @ pose[:, :3, 3:]
    return torch.cat([ray.reshape(-1, 9), shift.reshape(-1, 3)], dim=1).to(like.dtype).contiguous()


def _batched(*tensors: Tensor) -> list[Tensor]:
    """All operands with the leading axis of pairs, which the first one decides."""
    *images, K_i, K_j, pose = tensors
    single = images[0].dim() == 3
    images = [image[None] if image.dim() == 3 else image for image in images]
    matrices = [matrix[None] if matrix.dim() == 2 else matrix for matrix in (K_i, K_j, pose)]
    pairs = 1 if single else images[0].shape[0]
    for tensor, original in zip([*images, *matrices], tensors, strict=True):
        if tensor.dim() not in (3, 4) or tensor.shape[0] != pairs:
            raise ValueError(f"consistency: expected {pairs} pair(s) in every operand, got {list(original.shape)}")
    return [*images, *matrices]


def _check_size(name: str, depth: Tensor, image: Tensor) -> None:
    if depth.shape != (*image.shape[:3], 1):
        raise ValueError(f"{name}: expected {[*image.shape[:3], 1]} like its image, got {list(depth.shape)}")


def _unit_depth(mode: str) -> bool:
    if mode not in ("graphgs", "paper"):
        raise ValueError(f"mode: expected 'graphgs' or 'paper', got {mode!r}")
    return mode == "paper"
