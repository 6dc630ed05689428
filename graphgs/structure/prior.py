"""The coarse poses: what pairing sees, and our own first reconstruction that the final one starts from."""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.cameras import SharedCameras


@dataclass(frozen=True)
class Prior:
    """Coarse camera poses. Pairing alone looks at them, wherever they are from: a bad prior costs pairs, nothing else.

    `reconstruction` is made from the photos themselves, even where the poses are not; None: there is none."""

    names: tuple[str, ...]  # [N] all photos
    placed: np.ndarray  # [N] bool: has a pose below
    rotations: np.ndarray  # [N, 3, 3] camera-from-world; identity where not placed
    centers: np.ndarray  # [N, 3] world; NaN where not placed
    cameras: SharedCameras  # intrinsics of all photos, as far as known
    refine: tuple[str, ...]  # parameters of the lenses (`calibration.trials.PARAMETERS`) that the photos determine
    source: str  # auto | poses | gps | sequence
    note: str = ""  # how it came about
    oriented: bool = True  # False: positions only, `rotations` say nothing
    reconstruction: Reconstruction | None = None
    similar: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), np.int64))  # [N, k] look-alikes, best first
    origin: tuple[float, float, float] | None = None  # of gps: latitude, longitude [deg], altitude [m] of the world's 0

    def similar_pairs(self, photos: np.ndarray) -> np.ndarray:
        """[P, 2] i < j: every look-alike pair with at least one of `photos` (indices) in it."""
        if self.similar.size == 0 or len(photos) == 0:
            return np.zeros((0, 2), np.int64)
        i, rank = np.nonzero(self.similar >= 0)
        j = self.similar[i, rank]
        wanted = np.isin(i, photos) | np.isin(j, photos)
        pairs = np.sort(np.stack([i[wanted], j[wanted]], axis=1), axis=1)
        return np.unique(pairs, axis=0)

    def save(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        arrays = {k: getattr(self, k) for k in ("placed", "rotations", "centers", "similar")}
        np.savez(folder / "prior.npz", camera_ids=self.cameras.camera_ids, **arrays)
        header = {k: getattr(self, k) for k in ("names", "refine", "source", "note", "oriented", "origin")}
        header["cameras"] = self.cameras.records()
        (folder / "prior.json").write_text(json.dumps(header, indent=1))
        if self.reconstruction is not None:
            self.reconstruction.save(folder / "reconstruction")

    @staticmethod
    def load(folder: Path) -> "Prior":
        header = json.loads((folder / "prior.json").read_text())
        header["names"], header["refine"] = tuple(header["names"]), tuple(header["refine"])
        header["origin"] = None if header["origin"] is None else tuple(header["origin"])
        own = folder / "reconstruction"
        reconstruction = Reconstruction.load(own) if own.is_dir() else None
        with np.load(folder / "prior.npz", allow_pickle=False) as stored:
            arrays = dict(stored)
        header["cameras"] = SharedCameras.from_records(header["cameras"], arrays.pop("camera_ids"))
        return Prior(**header, **arrays, reconstruction=reconstruction)


def poses_by_name(names: tuple[str, ...], reconstruction: Reconstruction) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(placed [N], rotations [N, 3, 3], centers [N, 3]) of the named photos, as Prior holds them."""
    row = {name: k for k, name in enumerate(reconstruction.names)}
    placed = np.array([name in row for name in names], dtype=bool)
    rotations = np.tile(np.eye(3), (len(names), 1, 1))
    centers = np.full((len(names), 3), np.nan)
    rows = np.array([row[name] for name in names if name in row], dtype=np.int64)
    rotations[placed], centers[placed] = reconstruction.rotations[rows], reconstruction.centers[rows]
    return placed, rotations, centers
