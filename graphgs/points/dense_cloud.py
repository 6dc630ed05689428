"""Points on surfaces that several photos agree on."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class DenseCloud:
    """Each point lies on a surface that at least three training photos show; none comes from a held-out photo."""

    positions: np.ndarray  # [D, 3] world
    colors: np.ndarray  # [D, 3] uint8 RGB
    track_lengths: np.ndarray  # [D] int, photos that agree
    views: np.ndarray  # [D] int, the view that each was found in, at the middle of a pixel
    pixels: np.ndarray  # [D] side of the pixels compared, in pixels of that view

    @staticmethod
    def empty() -> "DenseCloud":
        return DenseCloud(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0, int), np.zeros(0, int), np.zeros(0))

    def __len__(self) -> int:
        return len(self.positions)

    def of_views(self, rows: np.ndarray) -> "DenseCloud":
        """What was found in these views, which are then numbered 0, 1, ..."""
        number = np.full(max(rows.max(initial=-1), self.views.max(initial=-1)) + 1, -1)
        number[rows] = np.arange(len(rows))
        kept = self.rows(np.flatnonzero(number[self.views] >= 0))
        return dataclasses.replace(kept, views=number[kept.views])

    def rows(self, chosen: np.ndarray) -> "DenseCloud":
        """These points alone."""
        return DenseCloud(*(getattr(self, f.name)[chosen] for f in dataclasses.fields(self)))

    def save(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(folder / "dense.npz", **{f.name: getattr(self, f.name) for f in dataclasses.fields(self)})

    @staticmethod
    def load(folder: Path) -> "DenseCloud":
        with np.load(folder / "dense.npz", allow_pickle=False) as arrays:
            return DenseCloud(**dict(arrays))
