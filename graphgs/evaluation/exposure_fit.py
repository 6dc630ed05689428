"""A second figure for held-out photos whose exposure differs: fitted on one half of the photo, scored on the other."""

import numpy as np

from graphgs.evaluation.metrics import psnr


def psnr_exposure_fitted(
    render: np.ndarray,  # [H, W, 3] float in 0..1
    truth: np.ndarray,  # [H, W, 3] uint8
    mask: np.ndarray | None = None,  # [H, W] bool, False = ignored
) -> float:
    """[dB] of the right half, after the affine colour transform that brings the left half nearest to the photo.

    Nothing of it reaches the scene, and no pixel is both fitted and scored. nan when a half has nothing to compare."""
    half = render.shape[1] // 2
    kept = np.ones(render.shape[:2], dtype=bool) if mask is None else mask
    if not kept[:, :half].any():
        return float("nan")
    colors = np.concatenate([render, np.ones_like(render[..., :1])], axis=-1).astype(np.float64)
    left = kept[:, :half]
    missing = (truth / 255.0 - render)[:, :half][left]
    # the change of least norm among the best: on a grey or plain half the channels cannot be told apart
    change = np.linalg.lstsq(colors[:, :half][left], missing, rcond=None)[0]
    fitted = render[:, half:] + colors[:, half:] @ change
    return psnr(fitted, truth[:, half:], kept[:, half:])
