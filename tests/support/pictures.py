"""Small photos for tests of what reads them."""

from pathlib import Path

import numpy as np
from PIL import Image


def picture(seed: int = 0, width: int = 48, height: int = 40) -> np.ndarray:
    """[H, W, 3] uint8, smooth colours that differ by seed."""
    y, x = np.mgrid[:height, :width]
    waves = [np.sin(0.05 * (seed + 1) * x + c) + np.cos(0.04 * y + seed + c) for c in range(3)]
    return np.clip(128 + 55 * np.stack(waves, axis=-1), 0, 255).astype(np.uint8)


def write_photos(folder: Path, count: int, *, suffix: str = "png", first: int = 0, **size) -> list[str]:
    """`count` different photos named 0000.png and so on; returns the names."""
    folder.mkdir(parents=True, exist_ok=True)
    names = [f"{i:04d}.{suffix}" for i in range(first, first + count)]
    for i, name in enumerate(names, first):
        Image.fromarray(picture(i, **size)).save(folder / name)
    return names
