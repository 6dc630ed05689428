"""How sharp and how rich in contrast photos are, to say why one could not be placed."""

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np

from graphgs.sources.photos import Photos
from graphgs.structure.edge_width import BLURRED_PX, edge_width

SIDE = 1000  # [px] photos are compared at one size: noise of the sensor is no sharpness
_EDGE = 8  # [px] removed around masked pixels


@dataclass(frozen=True)
class Sharpness:
    """Of photos, or of one; NaN: not measured."""

    sharpness: (
        np.ndarray
    )  # standard deviation of the Laplacian, 0..255: blur takes it, beside other photos of the scene
    contrast: np.ndarray  # standard deviation of the grey values, 0..255: blur leaves it; a blank wall has neither
    edge_px: np.ndarray  # see `edge_width`; blur by itself, in pixels of photos of at most `SIDE`

    @property
    def blurred(self) -> np.ndarray:
        """Whatever the others are like; False where not measured."""
        return np.nan_to_num(self.edge_px) >= BLURRED_PX


def sharpness(
    photos: Photos,
    chosen: np.ndarray,  # [K] int, photos to look at
    *,
    threads: int,
) -> Sharpness:
    """Of all photos [N], measured in those chosen."""
    found = np.full((len(photos.photos), 3), np.nan)

    def measure(k: int) -> None:
        photo = photos.photos[k]
        grey = _read(photos.folder / photo.pixels)
        mask = None if photo.mask is None else _read(photos.folder / photo.mask)
        found[k] = dataclasses.astuple(measure_sharpness(grey, mask))

    with ThreadPoolExecutor(max(1, threads)) as pool:
        list(pool.map(measure, (int(k) for k in chosen)))
    return Sharpness(*found.T)


def measure_sharpness(
    grey: np.ndarray,  # [H, W] uint8
    mask: np.ndarray | None = None,  # [H, W] uint8, 0 = ignore
) -> Sharpness:
    """Of one photo, as scalars."""
    scale = min(1.0, SIDE / max(grey.shape))
    if scale < 1.0:
        size = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        mask = None if mask is None else cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST)
    counts = np.ones(grey.shape, bool)
    if mask is not None:
        counts = cv2.erode((mask > 127).astype(np.uint8), np.ones((_EDGE, _EDGE), np.uint8)) > 0
    if not counts.any():
        return Sharpness(0.0, 0.0, np.nan)
    laplacian = float(cv2.Laplacian(grey, cv2.CV_32F)[counts].std())
    return Sharpness(laplacian, float(grey[counts].std()), edge_width(grey, counts))


def _read(path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise OSError(f"{path}: cannot read the decoded photo")
    return image
