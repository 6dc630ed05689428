"""Argument checks of the public losses."""

import torch
from torch import Tensor


def check_images(**images: Tensor) -> None:
    """Raise ValueError unless every image is [C, H, W, 3] and all share one float type and device."""
    first_name, first = next(iter(images.items()))
    for name, image in images.items():
        if image.dim() != 4 or image.shape[-1] != 3 or image.numel() == 0:
            raise ValueError(f"{name}: expected [C, H, W, 3], got {list(image.shape)}")
        check_real(**{name: image})
        if (image.dtype, image.device) != (first.dtype, first.device):
            wanted, got = f"{first.dtype} on {first.device}", f"{image.dtype} on {image.device}"
            raise ValueError(f"{name}: expected {wanted} like {first_name}, got {got}")


def check_real(**tensors: Tensor) -> None:
    """Raise ValueError unless every tensor is float32 or float64."""
    for name, tensor in tensors.items():
        if tensor.dtype not in (torch.float32, torch.float64):
            raise ValueError(f"{name}: expected float32 or float64, got {tensor.dtype}")


def as_real(image: Tensor, dtype: torch.dtype) -> Tensor:
    """An 8-bit image as values in 0..1; a float image in the wanted type. Without gradient."""
    scale = 255.0 if image.dtype == torch.uint8 else 1.0
    image = image.detach().to(dtype)
    return image if scale == 1.0 else image.div_(scale)
