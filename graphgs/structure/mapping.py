"""Final camera poses: a ladder of reconstructions, each step tried only where the one before was not accepted.

1. Triangulate the fine matches from the coarse poses, then two rounds of bundle adjustment and filtering.
2. Photos the coarse reconstruction missed: COLMAP's incremental mapper with the poses of 1 held, then 1 from its poses.
3. The incremental mapper from nothing on the same sparse graph, with two seeds, then 1 from its poses.
"""

import dataclasses
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.structure.acceptance import Agreement, agreement
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.colors import colored
from graphgs.structure.config import StructureConfig
from graphgs.structure.database import by_photo_names, by_pixel_files
from graphgs.structure.matching import Matches
from graphgs.structure.prior import Prior
from graphgs.structure.result import Structure, edges_among, left_out

_ANOTHER_SEED = 1000  # offset
# First a wide net, since coarse poses are off by a pixel or two. Then Cauchy's loss: repeated facades leave wrong
# tracks that no threshold finds; it cut the median position error to a quarter (castle .25 -> .06 %, fox .13 -> .08 %).
_WIDE = {"max_error_px": 8.0, "min_angle_deg": 1.5, "loss": "SOFT_L1", "loss_scale_px": 1.0}
_NARROW = {"loss": "CAUCHY", "loss_scale_px": 1.0}
_COMMON_SHARE = 0.5  # agreement on fewer of the photos says nothing about the rest
_ENOUGH_PHOTOS = 8  # of one camera, to determine its principal point
_FAR_OFF_CENTER = 0.1  # of the longer side: a principal point further out than this is not believed


@dataclass(frozen=True)
class _Candidate:
    """A reconstruction that a step of the ladder made, judged."""

    reconstruction: Reconstruction
    method: str
    agreement: Agreement | None
    compared_with: str
    accepted: bool

    @property
    def rank(self) -> tuple[bool, int]:
        return self.accepted, len(self.reconstruction.names)


def map_fine(
    config: StructureConfig,
    photos: Photos,
    matches: Matches,
    prior: Prior,
    *,
    scratch: Path,
    reporter: Reporter,
    threads: int,
    seed: int,
) -> Structure:
    """Climb the ladder until a reconstruction is accepted; else the best there is, not accepted.

    Each mapping call leaves its model in `scratch`: a killed run repeats at most one. Raises DataError when nothing
    could be reconstructed."""
    component = matches.component
    with ColmapWorker(scratch) as worker:
        mapper = _Mapper(config, photos, matches, prior, worker, scratch, reporter, threads, seed)
        best = _climb(config, mapper, prior.reconstruction, len(component), reporter)
        reporter.event("worker", stage="mapping", peak_rss_mb=round(worker.peak_rss_mb))
    if best is None:
        raise DataError(
            f"the matches of {len(component)} connected photos gave no reconstruction",
            hint="photos must be taken from different places (not turned on the spot) and overlap by half or more",
        )
    reconstruction = colored(best.reconstruction, photos, threads=threads)
    edges, inliers = edges_among(matches, reconstruction.names)
    return Structure(
        reconstruction,
        edges,
        inliers,
        best.accepted,
        best.method,
        best.agreement,
        best.compared_with,
        len(component),
        left_out(photos.names, reconstruction.names, component, matches.edges),
    )


def _climb(
    config: StructureConfig, mapper: "_Mapper", coarse: Reconstruction | None, component: int, reporter: Reporter
) -> _Candidate | None:
    best: _Candidate | None = None

    def judge(model: Reconstruction | None, method: str, other: Reconstruction | None, other_name: str) -> bool:
        """Whether the best so far is good enough; `model` has been compared with `other`."""
        nonlocal best
        if model is not None and other is not None:
            agreed = agreement(other, model)
            accepted = (
                agreed.within(config)
                and len(model.names) >= config.min_registered * component
                and agreed.common >= _COMMON_SHARE * len(model.names)
            )
        else:
            agreed, accepted = None, False
        if model is not None:
            found = _Candidate(model, method, agreed, other_name, accepted)
            if best is None or found.rank > best.rank:
                best = found
            figures = None if agreed is None else dataclasses.asdict(agreed)
            counts = {"registered": len(model.names), "component": component}
            reporter.event("mapping", method=method, accepted=accepted, agreement=figures, **counts)
        return best is not None and best.accepted

    first = None
    if coarse is not None:
        first = mapper.triangulated(coarse, "1_triangulated")
        judge(first, "triangulated from coarse poses", coarse, "the coarse reconstruction")
    if first is not None and len(first.names) < component:
        extended = mapper.incremental("2_extended", start="1_triangulated")
        if extended is not None:
            extended = mapper.triangulated(extended, "2_adjusted")
        judge(extended, "coarse poses, extended", coarse, "the coarse reconstruction")
    if best is not None and best.accepted:
        return best
    models = []
    for offset in (0, _ANOTHER_SEED):
        model = mapper.incremental(f"3_incremental_{offset}", seed_offset=offset)
        if model is not None:
            model = mapper.triangulated(model, f"3_adjusted_{offset}")
        if judge(model, "incremental", coarse, "the coarse reconstruction"):
            return best
        models.append(model)
    if all(model is not None for model in models):
        larger, other = sorted(models, key=lambda m: -len(m.names))
        judge(larger, "incremental, two seeds", other, "the same with another seed")
    return best


@dataclass(frozen=True)
class _Mapper:
    """The two mapping calls, with what they share. A model that is in scratch already is taken from there."""

    config: StructureConfig
    photos: Photos
    matches: Matches
    prior: Prior
    worker: ColmapWorker
    scratch: Path
    reporter: Reporter
    threads: int
    seed: int

    def triangulated(self, poses: Reconstruction, name: str) -> Reconstruction | None:
        """Triangulation from poses, then two rounds of bundle adjustment and filtering. The principal point is refined
        too where every camera has photos enough; if it runs away, once more without."""
        narrow = {**_NARROW, "max_error_px": self.config.max_error_px, "min_angle_deg": self.config.min_angle_deg}
        given = self.scratch / f"{name}_from"
        by_pixel_files(poses, self.photos).save(given)
        job = {"poses": given, "rounds": [_WIDE, narrow]}
        if self.prior.hold_intrinsics:
            return self._model(name, "triangulate", **job, refine=["poses"])
        if np.bincount(self.prior.cameras.camera_ids).min() >= _ENOUGH_PHOTOS:
            model = self._model(name, "triangulate", **job, refine=["poses", "intrinsics", "principal_point"])
            if model is None or _off_center(model) <= _FAR_OFF_CENTER:
                return model
            shutil.rmtree(self.scratch / name)
        return self._model(name, "triangulate", **job, refine=["poses", "intrinsics"])

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

    def _model(self, name: str, job: str, **arguments) -> Reconstruction | None:
        out = self.scratch / name
        if not out.exists():
            self.worker.run(
                job,
                progress=lambda done, total: self.reporter.progress(done, total, name.split("_", 1)[1]),
                **{"seed": self.seed, **arguments},
                database=self.matches.database,
                out=out,
                threads=self.threads,
            )
        return by_photo_names(Reconstruction.load(out), self.photos) if out.exists() else None


def _off_center(model: Reconstruction) -> float:
    """The largest distance of a principal point from the image's middle, as a share of the longer side."""
    return max(
        max(abs(cx - camera.width / 2), abs(cy - camera.height / 2)) / max(camera.width, camera.height)
        for camera in model.cameras
        for _, _, cx, cy in [camera.focal_and_center]
    )
