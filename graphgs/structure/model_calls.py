"""The mapping calls that the ladder is made of."""

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.sources.rigs import Rig
from graphgs.structure.calibration.belief import Calibration
from graphgs.structure.calibration.lens import refinements
from graphgs.structure.cameras import with_lenses
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.config import StructureConfig
from graphgs.structure.database import by_photo_names, by_pixel_files
from graphgs.structure.matching import Matches
from graphgs.structure.prior import Prior
from graphgs.structure.rigs import RigPose
from graphgs.structure.soundness import Witness

# First a wide net, since coarse poses are off by a pixel or two. Then Cauchy's loss: repeated facades leave wrong
# tracks that no threshold finds; it cut the median position error to a quarter (castle .25 -> .06 %, fox .13 -> .08 %).
WIDE = {"max_error_px": 8.0, "min_angle_deg": 1.5, "loss": "SOFT_L1", "loss_scale_px": 1.0, "tolerance": 1e-4}
NARROW = {"loss": "CAUCHY", "loss_scale_px": 1.0, "tolerance": 1e-5}


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
    calibration: Calibration | None = None  # what the photos said of the lenses; None: not asked yet

    def with_calibration(self, calibration: Calibration, model: Reconstruction) -> "ModelCalls":
        """The same with the lenses that the photos of a model speak for, and only what they determine refined."""
        cameras = with_lenses(self.prior.cameras, self.photos, model, calibration.cameras)
        prior = dataclasses.replace(self.prior, cameras=cameras, refine=calibration.refine)
        return dataclasses.replace(self, prior=prior, calibration=calibration)

    @cached_property
    def witness(self) -> Witness:
        """The matches that models are judged by."""
        database, least = self.matches.database, self.config.min_inliers
        return Witness.of(self.photos, database, self.prior.cameras, min_inliers=least)

    def triangulated(self, poses: Reconstruction, name: str) -> Reconstruction | None:
        """Triangulation from poses, then two rounds of bundle adjustment and filtering, with what `prior.refine` names
        of the lenses."""
        return self.adjusted(poses, name, rounds=(WIDE, NARROW))

    def adjusted(self, poses: Reconstruction, name: str, *, rounds: tuple[dict, ...]) -> Reconstruction | None:
        """The same with these rounds."""
        limits = {"max_error_px": self.config.max_error_px, "min_angle_deg": self.config.min_angle_deg}
        job = {"poses": self._write(poses, name), "rounds": [{**limits, **step} for step in rounds]}
        return self._model(name, "triangulate", **job, refine=["poses", *refinements(self.prior.refine)])

    def triangulated_only(self, poses: Reconstruction, name: str) -> Reconstruction | None:
        """Triangulation with poses and intrinsics exactly as they are."""
        return self._model(name, "triangulate", poses=self._write(poses, name), rounds=[self._narrow], refine=[])

    def incremental(
        self, name: str, *, start: str | None = None, seed_offset: int = 0, database: Path | None = None
    ) -> Reconstruction | None:
        """COLMAP's incremental mapper, from nothing or adding photos to the model of that name; `database`: other
        matches than all of them."""
        # Lenses that the photos were asked about will do to find poses with; left free, each new photo may bend them.
        free = () if self.calibration is not None else self.prior.refine
        focal, bending = ("focal" in free), bool({"k1", "k2"} & set(free))
        options = {
            "min_num_matches": self.config.min_inliers,
            "min_model_size": 3,
            "ba_refine_focal_length": focal,
            "ba_refine_extra_params": bending,
            "mapper": {"abs_pose_refine_focal_length": focal, "abs_pose_refine_extra_params": bending},
        }
        model = None if start is None else self.scratch / start / "colmap"
        cameras = self.prior.cameras
        if start is not None:
            found = by_photo_names(Reconstruction.load(self.scratch / start), self.photos)
            cameras = with_lenses(cameras, self.photos, found, found.cameras)
        job = {"start": model, "options": options, "seed": self.seed + seed_offset, "cameras": cameras.records()}
        return self._call(name, "map_incrementally", database=database or self.matches.database, **job)

    def globally(self, name: str) -> Reconstruction | None:
        """COLMAP's global mapper (GLOMAP)."""
        refine, cameras = bool(self.prior.refine), self.prior.cameras.records()
        return self._model(name, "map_globally", refine=refine, cameras=cameras)

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
        refine = ["poses", *refinements(self.prior.refine)]
        start = self.scratch / model / "colmap"
        return self._call(f"{model}_rig", "adjust_rigs", model=start, rigs=jobs, step=self._narrow, refine=refine)

    @property
    def _narrow(self) -> dict:
        return {**NARROW, "max_error_px": self.config.max_error_px, "min_angle_deg": self.config.min_angle_deg}

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
