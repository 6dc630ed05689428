"""What the training stage leaves."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.rendering.splats import Splats
from graphgs.training.stats import TrainStats


@dataclass(frozen=True)
class Trained:
    """The scene, the figures of its making, and what was fitted to the training views beside it."""

    splats: Splats
    stats: TrainStats
    viewmats: np.ndarray | None = None  # [N, 4, 4] refined poses, held-out views' as given; None = not refined
    exposures: np.ndarray | None = None  # [N, 3, 4] colour transforms, held-out views' the identity; None = not fitted

    def save(self, folder: Path) -> None:
        self.splats.save(folder)
        self.stats.save(folder)
        fits = {"viewmats": self.viewmats, "exposures": self.exposures}
        np.savez(folder / "fits.npz", **{name: array for name, array in fits.items() if array is not None})

    @staticmethod
    def load(folder: Path) -> "Trained":
        with np.load(folder / "fits.npz", allow_pickle=False) as arrays:
            return Trained(Splats.load(folder), TrainStats.load(folder), **dict(arrays))
