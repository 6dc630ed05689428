"""The photometric loss of 3DGS (Kerbl et al. 2023, Eq. 7): L1 and SSIM against a photo."""

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from graphgs.kernels.ssim import ImagePair, compare_images, compare_images_gradient
from graphgs.losses.checks import as_real, check_images
from graphgs.rendering.bridge import scalars, torch_stream
from graphgs.threads import get_num_threads


def ssim(
    a: Tensor,  # [C, H, W, 3] in 0..1
    b: Tensor,  # [C, H, W, 3] in 0..1
) -> Tensor:  # scalar: the mean over pixels and channels
    """Structural similarity (Wang et al. 2004; Gaussian window of 11 px, sigma 1.5), differentiable in both images.

    Zero padding beyond the rim, as 3DGS trains; the metric `graphgs.evaluation.ssim` instead leaves the rim out.
    """
    check_images(a=a, b=b)
    if a.shape != b.shape:
        raise ValueError(f"b: expected {list(a.shape)} like a, got {list(b.shape)}")
    return (_CompareImages.apply(a, b, None)[1] / a.numel()).to(a.dtype)


def photometric_loss(
    image: Tensor,  # [C, H, W, 3] in 0..1
    truth: Tensor,  # [C, H, W, 3] uint8, or float in 0..1; no gradient
    mask: Tensor | None = None,  # [C, H, W] or [C, H, W, 1]; 0 = ignore
    *,
    ssim_weight: float = 0.2,  # 3DGS, Eq. 7
) -> Tensor:  # scalar
    """(1 - w) L1 + w (1 - SSIM), means over the pixels kept.

    A masked pixel enters no mean, its gradient is exactly zero, and before SSIM's window it is replaced by the truth:
    what is rendered there has no influence on its neighbours either. With nothing kept the loss is 0.
    """
    check_images(image=image)
    if truth.shape != image.shape:
        raise ValueError(f"truth: expected {list(image.shape)} like the image, got {list(truth.shape)}")
    kept = None if mask is None else _kept(mask, image)
    sums = _CompareImages.apply(image, as_real(truth, image.dtype), kept)
    count = image.numel() if kept is None else 3 * kept.sum()
    # sums over nothing are 0, and the share of SSIM that can be lost is then 0 too
    kept_share = 1.0 if kept is None else (count > 0).to(sums.dtype)
    error, similarity = sums / (count if kept is None else count.clamp(min=1))
    return ((1 - ssim_weight) * error + ssim_weight * (kept_share - similarity)).to(image.dtype)


def _kept(mask: Tensor, image: Tensor) -> Tensor:  # [C, H, W, 1] bool
    if mask.shape == image.shape[:3]:
        mask = mask[..., None]
    if mask.shape != (*image.shape[:3], 1):
        raise ValueError(f"mask: expected {[*image.shape[:3], 1]} like the image, got {list(mask.shape)}")
    return mask != 0


class _CompareImages(torch.autograd.Function):
    """Sums of |a - b| and of SSIM over the kept values -> [2] float64."""

    @staticmethod
    def forward(ctx, a: Tensor, b: Tensor, kept: Tensor | None) -> Tensor:
        a, b = a.contiguous(), b.contiguous()
        if kept is None:
            weights = torch.ones_like(a)
        else:
            kept = torch.cat([kept] * 3, dim=-1)  # twice as fast as letting `where` broadcast it
            a = torch.where(kept, a, b)
            weights = kept.to(a.dtype)
        sums, slopes_a = _compare(a, b, weights)
        # The kernels differentiate in their first image only: training needs no more, and pays for no more.
        slopes_b = _compare(b, a, weights)[1] if ctx.needs_input_grad[1] else None
        ctx.save_for_backward(a, b, weights, slopes_a, slopes_b)
        return sums

    @staticmethod
    @once_differentiable
    def backward(ctx, v_sums: Tensor):
        a, b, weights, slopes_a, slopes_b = ctx.saved_tensors
        v_a = _gradient(a, b, weights, slopes_a, v_sums) if ctx.needs_input_grad[0] else None
        v_b = _gradient(b, a, weights, slopes_b, v_sums) if ctx.needs_input_grad[1] else None
        return v_a, v_b, None


def _compare(a: Tensor, b: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    sums = torch.empty(2, dtype=torch.float64, device=a.device)
    slopes = torch.empty((3, *a.shape), dtype=a.dtype, device=a.device)
    with torch_stream(a.device):
        compare_images(_pair(a, b, weights), scalars(slopes), scalars(sums), threads=get_num_threads())
    return sums, slopes


def _gradient(a: Tensor, b: Tensor, weights: Tensor, slopes: Tensor, v_sums: Tensor) -> Tensor:
    v_a = torch.empty_like(a)
    v_sums = v_sums.to(a.dtype)
    with torch_stream(a.device):
        compare_images_gradient(
            _pair(a, b, weights), scalars(slopes), scalars(v_sums), scalars(v_a), threads=get_num_threads()
        )
    return v_a


def _pair(a: Tensor, b: Tensor, weights: Tensor) -> ImagePair:
    return ImagePair(scalars(a), scalars(b), scalars(weights), height=a.shape[1], width=a.shape[2])
