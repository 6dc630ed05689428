"""Trial bundle adjustments of one model: other lenses, fewer tracks, some parameters open."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.calibration.lens import refinements
from graphgs.structure.colmap import ColmapWorker

_STEP = {"loss": "CAUCHY", "loss_scale_px": 1.0, "tolerance": 1e-6}


@dataclass(frozen=True)
class Trials:
    """Runs adjustments of the model in a folder (in COLMAP's format and as a Reconstruction), which stays as it is."""

    worker: ColmapWorker
    model: Path
    scratch: Path  # gets a folder per trial; one that is there already is not run again
    seed: int
    threads: int

    def run(
        self,
        name: str,
        cameras: tuple[Camera, ...],  # of the model, with the values to start from
        refine: tuple[str, ...],  # of PARAMETERS; others stay
        *,
        tracks: np.ndarray | None = None,  # [A] int: the points that take part; None: all that there are
        start: Path | None = None,  # an earlier trial to go on from, with its tracks
    ) -> tuple[Reconstruction, Path]:
        """The adjusted model and its folder."""
        folder = self.scratch / name
        if not folder.exists():
            self.scratch.mkdir(parents=True, exist_ok=True)
            chosen = None if tracks is None else self.scratch / f"{name}.npy"
            if chosen is not None:
                np.save(chosen, tracks)
            self.worker.run(
                "adjust",
                model=(start or self.model) / "colmap",
                out=folder,
                points=chosen,
                cameras=[dataclasses.asdict(camera) for camera in cameras],
                refine=["poses", *refinements(refine)],
                step=_STEP,
                seed=self.seed,
                threads=self.threads,
            )
        return Reconstruction.load(folder), folder
