"""The initial points of a scene, and what became of those they were made from."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class PrunedPoints:
    """M points to start Gaussians from, made from N reconstructed and dense ones."""

    positions: np.ndarray  # [M, 3] world
    colors: np.ndarray  # [M, 3] RGB, uint8 or float in 0..1 as the input was
    scales: np.ndarray  # [M] world, standard deviation of a round Gaussian
    representative: np.ndarray  # [N] int, the point each input point was merged into
    coverage: float  # world, largest distance from a dropped point to its representative

    def save(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(folder / "points.npz", **{f.name: getattr(self, f.name) for f in dataclasses.fields(self)})

    @staticmethod
    def load(folder: Path) -> "PrunedPoints":
        with np.load(folder / "points.npz", allow_pickle=False) as arrays:
            fields = dict(arrays)
        return PrunedPoints(**{**fields, "coverage": float(fields["coverage"])})
