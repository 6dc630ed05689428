"""Mappings of a coarse database: loose incremental reconstructions from given intrinsics."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.structure.cameras import SharedCameras
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.database import by_photo_names

# Bundle adjustment that stops where it hardly gains: a third less time in all, poses as accurate (0027).
_QUICKLY_SOLVED = {
    "ba_global_function_tolerance": 1e-4,
    "ba_global_max_num_iterations": 20,
    "ba_local_function_tolerance": 1e-4,
    "ba_local_max_num_iterations": 15,
}
# Looser than COLMAP's defaults: features are few, and a wrong photo here costs pairs only.
_OPTIONS = {
    "min_num_matches": 12,
    "min_model_size": 3,
    "max_num_models": 10,
    "ba_global_frames_ratio": 1.3,
    "ba_global_points_ratio": 1.3,
    "ba_global_max_refinements": 2,
    "ba_local_max_refinements": 1,
    **_QUICKLY_SOLVED,
    "mapper": {
        "init_min_num_inliers": 50,
        "init_min_tri_angle": 8.0,
        "abs_pose_min_num_inliers": 15,
        "abs_pose_min_inlier_ratio": 0.15,
    },
}
_HELD = {
    **_OPTIONS,
    "ba_refine_focal_length": False,
    "ba_refine_extra_params": False,
    "mapper": {
        **_OPTIONS["mapper"],
        "abs_pose_refine_focal_length": False,
        "abs_pose_refine_extra_params": False,
    },
}
_LARGEST_DRIFT = 1.6  # a focal length that mapping changed by more is a sign of a broken model
ABOUT_AS_MANY = 0.98  # of the photos that the best mapping places


@dataclass(frozen=True)
class Mapped:
    """A coarse model."""

    model: Reconstruction  # by photo names
    cameras: SharedCameras  # intrinsics that it started from, or was adjusted with
    folder: Path  # of the same model, by pixel files


@dataclass(frozen=True)
class CoarseMapper:
    """Maps the database in a work folder. A model that is there already is not made again."""

    photos: Photos
    worker: ColmapWorker
    work: Path  # holds database.db
    reporter: Reporter
    threads: int

    @property
    def database(self) -> Path:
        return self.work / "database.db"

    def mapped(self, cameras: SharedCameras, seed: int, label: str, *, hold: bool) -> Mapped | None:
        """A mapping from nothing with these intrinsics to start from, or to `hold`; None where there is none, or where
        it drifted away from the focal lengths it started from."""
        model = self.work / f"model_{seed}_{label}{'_held' if hold else ''}"
        if not model.exists():
            self.worker.run("set_cameras", database=self.database, cameras=cameras.records())
            self.worker.run(
                "map_incrementally",
                progress=lambda done, total: self.reporter.progress(done, total, "coarse mapping"),
                database=self.database,
                out=model,
                start=None,
                options=_HELD if hold else _OPTIONS,
                seed=seed,
                threads=self.threads,
            )
        if not model.exists():
            return None
        found = by_photo_names(Reconstruction.load(model), self.photos)
        drift = _drift(found, cameras, self.photos)
        figures = {"placed": len(found.names), "error_px": mean_error(found), "drift": drift}
        self.reporter.event("coarse_mapping", name=label, **figures)
        return Mapped(found, cameras, model) if drift <= _LARGEST_DRIFT else None

    def best(self, guesses: list[SharedCameras], seed: int, *, hold: bool) -> Mapped | None:
        """Of the mappings from several intrinsics the one that places the most photos, and among those that place about
        as many the one with the least error: far off the true focal length a turn of the road bends wrongly, and the
        error grows by a quarter."""
        tried = (self.mapped(cameras, seed, str(k), hold=hold) for k, cameras in enumerate(guesses))
        results = [found for found in tried if found is not None]
        if not results:
            return None
        most = max(len(found.model.names) for found in results)
        even = [found for found in results if len(found.model.names) >= ABOUT_AS_MANY * most]
        return min(even, key=lambda found: mean_error(found.model))


def mean_error(model: Reconstruction) -> float:
    """[px]"""
    return float(model.errors.mean()) if len(model.errors) else np.inf


def _drift(found: Reconstruction, start: SharedCameras, photos: Photos) -> float:
    """The largest factor by which mapping changed a focal length."""
    row = {name: k for k, name in enumerate(photos.names)}
    before = np.array([start.cameras[start.camera_ids[row[name]]].params[0] for name in found.names])
    after = np.array([found.camera_of(k).params[0] for k in range(len(found.names))])
    return float(np.exp(np.abs(np.log(np.maximum(after, 1e-6) / before)).max()))
