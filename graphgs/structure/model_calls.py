"""The mapping calls that the ladder is made of."""

import shutil
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.sources.rigs import Rig
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.config import StructureConfig
from graphgs.structure.database import by_photo_names, by_pixel_files
from graphgs.structure.matching import Matches
from graphgs.structure.prior import Prior
from graphgs.structure.rigs import RigPose
from graphgs.structure.soundness import Witness

# First a wide net, since coarse poses are off by a pixel or two. Then Cauchy's loss: repeated facades leave wrong
# tracks that no threshold finds; it cut the median position error to a quarter (castle .25 -> .06 %, fox .13 -> .08 %).
_WIDE = {"max_error_px": 8.0, "min_angle_deg": 1.5, "loss": "SOFT_L1", "loss_scale_px": 1.0, "tolerance": 1e-4}
_NARROW = {"loss": "CAUCHY", "loss_scale_px": 1.0, "tolerance": 1e-5}
_ENOUGH_PHOTOS = 8  # of one camera, to determine its principal point
_FAR_OFF_CENTER = 0.1  # of the longer side: a principal point further out than this is not believed


@dataclass(frozen=True)
class ModelCalls:
    """The mapping calls, with what they share. A model that is in scratch already is taken from there."""

    config: StructureConfig
    photos: Photos
    matches: Matches
    prior: Prior
    worker: ColmapWorker
    scratch: Path
    reporter: Reporter
    threads: int
    seed: int

    @cached_property
    def witness(self) -> Witness:
        """The matches that models are judged by."""
        database, least = self.matches.database, self.config.min_inliers
        return Witness.of(self.photos, database, self.prior.cameras, min_inliers=least)

    def triangulated(self, poses: Reconstruction, name: str) -> Reconstruction | None:
        """Triangulation from poses, then two rounds of bundle adjustment and filtering. The principal point is refined
        too where every camera has photos enough; if it runs away, once more without."""
        job = {"poses": self._write(poses, name), "rounds": [_WIDE, self._narrow]}
        if self.prior.hold_intrinsics:
            return self._model(name, "triangulate", **job, refine=["poses"])
        if np.bincount(self.prior.cameras.camera_ids).min() >= _ENOUGH_PHOTOS:
            model = self._model(name, "triangulate", **job, refine=["poses", "intrinsics", "principal_point"])
            if model is None or _off_center(model) <= _FAR_OFF_CENTER:
                return model
            shutil.rmtree(self.scratch / name)
        return self._model(name, "triangulate", **job, refine=["poses", "intrinsics"])

    def triangulated_only(self, poses: Reconstruction, name: str) -> Reconstruction | None:
        """Triangulation with poses and intrinsics exactly as they are."""
        return self._model(name, "triangulate", poses=self._write(poses, name), rounds=[self._narrow], refine=[])

    def incremental(self, name: str, *, start: str | None = None, seed_offset: int = 0) -> Reconstruction | None:
        """COLMAP's incremental mapper, from nothing or adding photos to the model of that name."""
        refine = not self.prior.hold_intrinsics
        options = {
            "min_num_matches": self.config.min_inliers,
            "min_model_size": 3,
            "ba_refine_focal_length": refine,
            "ba_refine_extra_params": refine,
            "mapper": {"abs_pose_refine_focal_length": refine, "abs_pose_refine_extra_params": refine},
        }
        model = None if start is None else self.scratch / start / "colmap"
        return self._model(name, "map_incrementally", start=model, options=options, seed=self.seed + seed_offset)

    def globally(self, name: str) -> Reconstruction | None:
        """COLMAP's global mapper (GLOMAP)."""
        return self._model(name, "map_globally", refine=not self.prior.hold_intrinsics)

    def rig_adjusted(self, model: str, rigs: list[tuple[Rig, RigPose]]) -> Reconstruction | None:
        """The model of that name after bundle adjustment with one place on its rig per camera."""
        files = [photo.pixels for photo in self.photos.photos]
        jobs = [
            {
                "images": [[files[k] if k >= 0 else None for k in frame] for frame in rig.photos],
                "rotations": pose.rotations.tolist(),
                "translations": pose.translations.tolist(),
            }
            for rig, pose in rigs
        ]
        refine = ["poses"] if self.prior.hold_intrinsics else ["poses", "intrinsics"]
        start = self.scratch / model / "colmap"
        return self._call(f"{model}_rig", "adjust_rigs", model=start, rigs=jobs, step=self._narrow, refine=refine)

    @property
    def _narrow(self) -> dict:
        return {**_NARROW, "max_error_px": self.config.max_error_px, "min_angle_deg": self.config.min_angle_deg}

    def _write(self, poses: Reconstruction, name: str) -> Path:
        folder = self.scratch / f"{name}_from"
        by_pixel_files(poses, self.photos).save(folder)
        return folder

    def _model(self, name: str, job: str, **arguments) -> Reconstruction | None:
        return self._call(name, job, database=self.matches.database, **arguments)

    def _call(self, name: str, job: str, **arguments) -> Reconstruction | None:
        out = self.scratch / name
        if not out.exists():
            self.worker.run(
                job,
                progress=lambda done, total: self.reporter.progress(done, total, f"mapping: {name}"),
                **{"seed": self.seed, **arguments},
                out=out,
                threads=self.threads,
            )
        model = Reconstruction.load(out) if out.exists() else None
        if model is None or not model.names:  # filtering may leave no photo at all
            return None
        return by_photo_names(model, self.photos)


def _off_center(model: Reconstruction) -> float:
    """The largest distance of a principal point from the image's middle, as a share of the longer side."""
    return max(
        max(abs(cx - camera.width / 2), abs(cy - camera.height / 2)) / max(camera.width, camera.height)
        for camera in model.cameras
        for _, _, cx, cy in [camera.focal_and_center]
    )
