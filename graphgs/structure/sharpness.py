"""How sharp and how rich in contrast photos are, to say why one could not be placed."""

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np

from graphgs.sources.photos import Photos

_SIDE = 1000  # [px] photos are compared at one size: noise of the sensor is no sharpness
_EDGE = 8  # [px] removed around masked pixels


def sharpness(
    photos: Photos,
    chosen: np.ndarray,  # [K] int, photos to look at
    *,
    threads: int,
) -> tuple[np.ndarray, np.ndarray]:
    """(sharpness [N], contrast [N]): the standard deviations of the Laplacian and of the grey values, 0..255; NaN where
    not looked at. Blur takes the first and leaves the second; a blank wall has neither."""
    found = np.full((len(photos.photos), 2), np.nan)

    def measure(k: int) -> None:
        photo = photos.photos[k]
        grey = _read(photos.folder / photo.pixels)
        mask = None if photo.mask is None else _read(photos.folder / photo.mask)
        found[k] = measure_sharpness(grey, mask)

    with ThreadPoolExecutor(max(1, threads)) as pool:
        list(pool.map(measure, (int(k) for k in chosen)))
    return found[:, 0], found[:, 1]


def measure_sharpness(
    grey: np.ndarray,  # [H, W] uint8
    mask: np.ndarray | None = None,  # [H, W] uint8, 0 = ignore
) -> tuple[float, float]:
    """(sharpness, contrast) of one photo."""
    scale = min(1.0, _SIDE / max(grey.shape))
    if scale < 1.0:
        size = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        mask = None if mask is None else cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST)
    counts = np.ones(grey.shape, bool)
    if mask is not None:
        counts = cv2.erode((mask > 127).astype(np.uint8), np.ones((_EDGE, _EDGE), np.uint8)) > 0
    if not counts.any():
        return 0.0, 0.0
    return float(cv2.Laplacian(grey, cv2.CV_32F)[counts].std()), float(grey[counts].std())


def _read(path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise OSError(f"{path}: cannot read the decoded photo")
    return image
