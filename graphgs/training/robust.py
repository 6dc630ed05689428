"""What a photo shows and the scene does not: passers-by and cars are left out of the loss."""

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

PATCH = 9  # px: things that pass by are larger, fine texture that is not learned yet is smaller
LEAST_ERROR = 0.04  # mean difference of a patch, of colours in 0..1; below, nothing is an outlier


@torch.no_grad()
def fitting_pixels(
    colors: Tensor,  # [1, H, W, 3] rendered, in 0..1
    photo: Tensor,  # [1, H, W, 3] in 0..1
    mask: Tensor | None,  # [1, H, W, 1]; 0 = left out already
    *,
    share: float,  # largest share of the pixels to leave out
) -> Tensor:
    """[1, H, W, 1]: the mask without the `share` of pixels whose surroundings fit worst, as long as they fit badly at
    all (after RobustNeRF, Sabour et al. 2023: trimmed by rank, and in patches, because outliers hang together)."""
    error = (colors.detach() - photo).abs().mean(dim=-1)[:, None]  # [1, 1, H, W]
    if mask is not None:
        error = error * mask.permute(0, 3, 1, 2)
    error = avg_pool2d(error, PATCH, stride=1, padding=PATCH // 2, count_include_pad=False)
    kept = error.numel() - int(share * error.numel())
    limit = torch.kthvalue(error.flatten(), max(1, kept)).values.clamp(min=LEAST_ERROR)
    fits = (error <= limit).to(photo.dtype).permute(0, 2, 3, 1)
    return fits if mask is None else fits * mask
