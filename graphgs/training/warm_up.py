"""Resolution warm-up: the first steps look at reduced photos, which cost less and pull centres from further away."""

import torch
from torch import Tensor

LEAST_SIDE = 12  # [px] no photo is reduced to less: SSIM's window has 11


def reduction_of(
    width: int,  # [px]
    height: int,  # [px]
    wanted: int,  # 4, 2 or 1
) -> int:
    """The reduction `wanted`, or what of it a small photo bears."""
    while wanted > 1 and min(width, height) // wanted < LEAST_SIDE:
        wanted //= 2
    return wanted


def reduce_photo(
    photo: Tensor,  # [1, H, W, 3]
    mask: Tensor | None,  # [1, H, W, 1] 0 or 1
    factor: int,
) -> tuple[Tensor, Tensor | None]:
    """Means of factor x factor pixels, at most factor - 1 rows and columns cut off; a mean counts if all of its pixels
    do."""
    if factor == 1:
        return photo, mask
    small = torch.nn.functional.avg_pool2d(photo.movedim(-1, 1), factor).movedim(1, -1).contiguous()
    if mask is None:
        return small, None
    ignored = torch.nn.functional.max_pool2d(1.0 - mask.movedim(-1, 1), factor)
    return small, (1.0 - ignored).movedim(1, -1).contiguous()


def reduce_camera(
    K: Tensor,  # [1, 3, 3] px
    width: int,  # [px]
    height: int,  # [px]
    factor: int,
) -> tuple[Tensor, int, int]:
    """K, width and height of the reduced photo. Exact: pixel centres lie at +0.5, so every pixel coordinate is divided
    by the factor, the principal point's too."""
    if factor == 1:
        return K, width, height
    return torch.cat([K[:, :2] / factor, K[:, 2:]], dim=1), width // factor, height // factor
