"""Argument checks of `rasterize`: every message names the argument, what was expected and what came."""

import torch
from torch import Tensor

MAX_CHANNELS = 32


def check_tensors(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    backgrounds: Tensor | None,
    *,
    sh_degree: int | None,
) -> None:
    """Shapes, types and devices. Raises ValueError."""
    if not isinstance(means, Tensor) or means.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"means: expected float32 or float64, got {_kind(means)}")
    n = means.shape[0] if means.dim() else 0
    c = viewmats.shape[0] if isinstance(viewmats, Tensor) and viewmats.dim() else 0
    expected = {
        "means": (means, (n, 3)),
        "quats": (quats, (n, 4)),
        "scales": (scales, (n, 3)),
        "opacities": (opacities, (n,)),
        "colors": (colors, _colors_shape(colors, n, sh_degree)),
        "viewmats": (viewmats, (c, 4, 4)),
        "Ks": (Ks, (c, 3, 3)),
    }
    if backgrounds is not None:
        expected["backgrounds"] = (backgrounds, (c, expected["colors"][1][-1]))
    for name, (tensor, size) in expected.items():
        if not isinstance(tensor, Tensor):
            raise ValueError(f"{name}: expected a tensor, got {_kind(tensor)}")
        if tuple(tensor.shape) != size:
            raise ValueError(f"{name}: expected {list(size)}, got {list(tensor.shape)}")
        if tensor.dtype != means.dtype:
            raise ValueError(f"{name}: expected {means.dtype} as means, got {tensor.dtype}")
        if tensor.device != means.device:
            raise ValueError(f"{name}: expected device {means.device} as means, got {tensor.device}")
    if c < 1:
        raise ValueError("viewmats: expected at least one camera, got none")


def _colors_shape(colors: Tensor, n: int, sh_degree: int | None) -> tuple[int, ...]:
    """The shape colours should have; their own where it is acceptable."""
    got = list(colors.shape) if isinstance(colors, Tensor) else []
    if sh_degree is None:
        channels = got[1] if len(got) == 2 else 3
        if not 1 <= channels <= MAX_CHANNELS:
            raise ValueError(f"colors: expected [{n}, D] with D in 1 to {MAX_CHANNELS}, got {got}")
        return n, channels
    if sh_degree not in (0, 1, 2, 3):
        raise ValueError(f"sh_degree: expected 0, 1, 2, 3 or None, got {sh_degree}")
    least = (sh_degree + 1) ** 2
    k = got[1] if len(got) == 3 else 0
    if k < least:
        raise ValueError(f"colors: expected [{n}, K, 3] with K >= {least} for sh_degree={sh_degree}, got {got}")
    return n, k, 3


def check_masks(masks: Tensor | None, size: tuple[int, int, int], device: torch.device) -> None:
    if masks is None:
        return
    if not isinstance(masks, Tensor) or masks.dtype != torch.bool:
        raise ValueError(f"masks: expected torch.bool, got {_kind(masks)}")
    if tuple(masks.shape) != size:
        raise ValueError(f"masks: expected {list(size)}, got {list(masks.shape)}")
    if masks.device != device:
        raise ValueError(f"masks: expected device {device} as means, got {masks.device}")


def check_options(width: int, height: int, near: float, far: float, eps2d: float) -> None:
    if width < 1 or height < 1:
        raise ValueError(f"width and height: expected at least 1, got {width} x {height}")
    if not 0 < near < far:
        raise ValueError(f"near and far: expected 0 < near < far, got {near} and {far}")
    if not eps2d >= 0:
        raise ValueError(f"eps2d: expected at least 0, got {eps2d}")


def check_finite(**tensors: Tensor | None) -> None:
    """Raise ValueError where a value is NaN or infinite."""
    for name, tensor in tensors.items():
        # A finite sum has finite terms, and costs a fraction of a mask; only a sum that overflowed needs the mask.
        if tensor is not None and not torch.isfinite(tensor.detach().sum()):
            bad = int((~torch.isfinite(tensor)).sum())
            if bad:
                raise ValueError(f"{name}: expected finite values, got {bad} that are NaN or infinite")


def check_focal(Ks: Tensor) -> None:
    """Raise ValueError where a focal length is not positive."""
    focal = Ks.detach()[:, (0, 1), (0, 1)]
    if not (focal > 0).all():
        raise ValueError(f"Ks: expected positive focal lengths, got {focal.min():g}")


def _kind(value) -> str:
    return str(value.dtype) if isinstance(value, Tensor) else type(value).__name__
