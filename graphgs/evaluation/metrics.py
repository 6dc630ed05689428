"""Image metrics of held-out views, in float64. Images are NumPy arrays or tensors; 8-bit ones are divided by 255."""

import math

import numpy as np
from scipy.ndimage import correlate1d

_RADIUS = 5  # [px] of SSIM's window, 11 px wide
_SIGMA = 1.5  # [px]
_C1, _C2 = 0.01**2, 0.03**2


def psnr(
    render,  # [..., H, W, 3] float, clamped to 0..1 here (or uint8)
    truth,  # the same shape, uint8 (or float in 0..1)
    mask=None,  # [..., H, W] or [..., H, W, 1]; 0 = ignore
) -> float:
    """Peak signal-to-noise ratio in dB over the pixels kept: inf for equal images, nan when none is kept."""
    render, truth, kept = _operands(render, truth, mask)
    squares = (render - truth)[kept] ** 2
    if squares.size == 0:
        return math.nan
    mean = float(squares.mean())
    return math.inf if mean == 0.0 else -10.0 * math.log10(mean)


def ssim(
    render,  # [..., H, W, 3] float, clamped to 0..1 here (or uint8); H and W at least 11
    truth,  # the same shape, uint8 (or float in 0..1)
    mask=None,  # [..., H, W] or [..., H, W, 1]; 0 = ignore
) -> float:
    """Mean structural similarity (Wang et al. 2004; Gaussian window of 11 px, sigma 1.5, population variances).

    As scikit-image computes it, the 5 px at the rim, whose window reaches beyond the image, are left out. Masked pixels
    of the render are replaced by the truth before the window and enter no mean; nan when none is kept.
    """
    render, truth, kept = _operands(render, truth, mask)
    height, width = render.shape[-3:-1]
    if min(height, width) < 2 * _RADIUS + 1:
        raise ValueError(f"render: SSIM needs at least 11 x 11 px, got {width} x {height}")
    render = np.where(kept[..., None], render, truth)
    mean_a, mean_b = _window(render), _window(truth)
    energy, cross = mean_a**2 + mean_b**2, mean_a * mean_b
    variances = _window(render**2 + truth**2) - energy
    covariance = _window(render * truth) - cross
    similarity = (2 * cross + _C1) * (2 * covariance + _C2) / ((energy + _C1) * (variances + _C2))
    inner = slice(_RADIUS, -_RADIUS)
    values = similarity[..., inner, inner, :][kept[..., inner, inner]]
    return float(values.mean()) if values.size else math.nan


def _window(image: np.ndarray) -> np.ndarray:
    offsets = np.arange(-_RADIUS, _RADIUS + 1)
    weights = np.exp(-0.5 * (offsets / _SIGMA) ** 2)
    weights /= weights.sum()
    return correlate1d(correlate1d(image, weights, axis=-3), weights, axis=-2)


def _operands(render, truth, mask) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    render, truth = _values(render), _values(truth)
    if render.shape != truth.shape or render.ndim < 3 or render.shape[-1] != 3:
        raise ValueError(f"render, truth: expected two [..., H, W, 3], got {list(render.shape)}, {list(truth.shape)}")
    if mask is None:
        return render, truth, np.ones(render.shape[:-1], dtype=bool)
    kept = _array(mask) != 0
    if kept.shape == (*render.shape[:-1], 1):
        kept = kept[..., 0]
    if kept.shape != render.shape[:-1]:
        raise ValueError(f"mask: expected {list(render.shape[:-1])} like the images, got {list(kept.shape)}")
    return render, truth, kept


def _values(image) -> np.ndarray:
    image = _array(image)
    if image.dtype == np.uint8:
        return image / 255.0
    return np.clip(image.astype(np.float64), 0.0, 1.0)


def _array(image) -> np.ndarray:
    if hasattr(image, "detach"):  # a tensor, also one with a gradient or on a GPU
        image = image.detach().cpu().numpy()
    return np.asarray(image)
