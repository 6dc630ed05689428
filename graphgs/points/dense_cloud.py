"""Points on surfaces that several photos agree on."""

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
    pixel: float  # side of the pixels compared, in pixels of the training images

    @staticmethod
    def empty() -> "DenseCloud":
        return DenseCloud(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0, int), np.zeros(0, int), 1.0)

    def __len__(self) -> int:
        return len(self.positions)

    def of_views(self, rows: np.ndarray) -> "DenseCloud":
        """What was found in these views, which are then numbered 0, 1, ..."""
        number = np.full(max(rows.max(initial=-1), self.views.max(initial=-1)) + 1, -1)
        number[rows] = np.arange(len(rows))
        kept = number[self.views] >= 0
        fields = (self.positions, self.colors, self.track_lengths)
        return DenseCloud(*(field[kept] for field in fields), number[self.views[kept]], self.pixel)

    def save(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(
            folder / "dense.npz", positions=self.positions, colors=self.colors,
            track_lengths=self.track_lengths, views=self.views, pixel=self.pixel,
        )  # fmt: skip

    @staticmethod
    def load(folder: Path) -> "DenseCloud":
        with np.load(folder / "dense.npz", allow_pickle=False) as arrays:
            fields = dict(arrays)
        return DenseCloud(**{**fields, "pixel": float(fields["pixel"])})
