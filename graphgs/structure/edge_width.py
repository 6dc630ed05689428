"""How wide the edges of a photo are: sharpness that means something by itself, in pixels.

A step edge that blur of standard deviation s has widened loses gradient when it is blurred once more by s0: by the
factor sqrt(1 + (s0 / s)^2), whatever its contrast (Zhuo and Sim 2011). So the ratio of the gradients before and after
tells s. Fog, darkness and coarse JPEG leave it; the sharpest quarter of the edges is taken, as most of a scene may well
be soft; and the worst of four directions, as a shaken camera leaves edges along its movement sharp.
"""

import cv2
import numpy as np

BLURRED_PX = 5.0  # edges this wide hold no more detail than a photo of a third of the size does (MTF below .1 beyond)

_BEFORE, _AGAIN = 1.0, 2.0  # [px] standard deviations: of smoothing against noise, and of the blur once more
_RISE = 2.563  # standard deviations from 10 to 90 % of a blurred step
_EDGE_SHARE = 10.0  # % of the pixels, those with the largest gradients
_WEAKEST = 1.0  # [grey values per px] below it is noise
_SHARPEST = 25.0  # percentile
_DIRECTIONS = 4
_FEWEST_EDGES = 50  # pixels of one direction, and this share of all
_FEWEST_SHARE = 0.05
_BORDER = 8  # px


def blur_words(edge_px: float) -> str:
    """For people."""
    return f"blurred: edges are {edge_px:.0f} px wide, sharp ones 1 to 3"


def edge_width(
    grey: np.ndarray,  # [H, W] uint8
    counts: np.ndarray | None = None,  # [H, W] bool: pixels to look at
) -> float:
    """[px] from 10 to 90 % of the rise of the sharpest edges, in the direction where they are widest; 0 for edges as
    sharp as pixels are, NaN where there are too few to tell. Takes some .5 px too little where edges differ much."""
    first = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _BEFORE)
    gx, gy = _gradient(first)
    size = np.hypot(gx, gy)
    edges = _ridge(size, gx, gy) & (size > max(np.percentile(size, 100.0 - _EDGE_SHARE), _WEAKEST))
    edges[:_BORDER], edges[-_BORDER:], edges[:, :_BORDER], edges[:, -_BORDER:] = False, False, False, False
    if counts is not None:
        edges &= counts
    if edges.sum() < _FEWEST_EDGES:
        return float("nan")
    hx, hy = _gradient(cv2.GaussianBlur(first, (0, 0), _AGAIN))
    kept = (gx * hx + gy * hy)[edges] / (size * size)[edges]  # of the gradient, after blurring once more
    gain = 1.0 / np.clip(kept, 1e-3, 1.0 - 1e-4)
    variance = _AGAIN**2 / (gain * gain - 1.0) - _BEFORE**2
    sector = np.round(np.arctan2(gy, gx)[edges] / (np.pi / _DIRECTIONS)).astype(int) % _DIRECTIONS
    fewest = max(_FEWEST_EDGES, _FEWEST_SHARE * edges.sum())
    sharpest = [
        np.percentile(variance[sector == k], _SHARPEST) for k in range(_DIRECTIONS) if (sector == k).sum() >= fewest
    ]
    return float(_RISE * np.sqrt(max(*sharpest, 0.0))) if sharpest else float("nan")


def _gradient(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[grey values per px]"""
    return tuple(cv2.Sobel(image, cv2.CV_32F, *axis, scale=1.0 / 8.0) for axis in ((1, 0), (0, 1)))


def _ridge(size: np.ndarray, gx: np.ndarray, gy: np.ndarray) -> np.ndarray:
    """[H, W] bool: the gradient is largest across the edge."""
    across = [np.maximum(np.roll(size, 1, axis), np.roll(size, -1, axis)) for axis in (0, 1)]
    return size >= np.where(np.abs(gx) >= np.abs(gy), across[1], across[0])
