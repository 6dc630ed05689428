"""Final camera poses: a ladder of reconstructions, each step tried only where the one before was not accepted.

1. Triangulate the fine matches from the coarse poses, then two rounds of bundle adjustment and filtering.
2. Photos the coarse reconstruction missed: COLMAP's incremental mapper with the poses of 1 held, then 1's adjustment.
3. The incremental mapper from nothing on the same sparse graph, with two seeds.
"""

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.acceptance import Agreement, agreement
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.config import StructureConfig
from graphgs.structure.database import by_photo_names, by_pixel_files
from graphgs.structure.matching import Matches
from graphgs.structure.prior import Prior

_ANOTHER_SEED = 1000  # offset
# First a wide net and a loss that outliers cannot bend, since coarse poses are off by a pixel or two.
_WIDE = {"max_error_px": 8.0, "min_angle_deg": 1.5, "robust": True, "refine": True}


@dataclass(frozen=True)
class Structure:
    """The final reconstruction, whether to trust it and why, and the photos it lacks."""

    reconstruction: Reconstruction
    accepted: bool
    method: str  # the step of the ladder, or "given"
    agreement: Agreement | None  # with the reconstruction made apart; None for poses that came with the input
    compared_with: str  # what `agreement` is with
    component: int  # photos in the largest connected group
    unregistered: tuple[tuple[str, str], ...]  # (name, reason)

    @property
    def status(self) -> str:
        return "ok" if self.accepted else "partial"

    def save(self, folder: Path) -> None:
        self.reconstruction.save(folder)
        header = {
            "accepted": self.accepted,
            "method": self.method,
            "agreement": None if self.agreement is None else dataclasses.asdict(self.agreement),
            "compared_with": self.compared_with,
            "component": self.component,
            "unregistered": [list(entry) for entry in self.unregistered],
        }
        (folder / "structure.json").write_text(json.dumps(header, indent=1))

    @staticmethod
    def load(folder: Path) -> "Structure":
        header = json.loads((folder / "structure.json").read_text())
        header["agreement"] = None if header["agreement"] is None else Agreement(**header["agreement"])
        header["unregistered"] = tuple(tuple(entry) for entry in header["unregistered"])
        return Structure(Reconstruction.load(folder), **header)


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
    photos,
    matches: Matches,
    prior: Prior,
    *,
    scratch: Path,
    reporter: Reporter,
    threads: int,
    seed: int,
) -> Structure:
    """Climb the ladder until a reconstruction is accepted; else the best there is, not accepted.

    Each mapping call leaves its model in `scratch`: a killed run repeats at most one. Raises DataError when nothing could
    be reconstructed."""
    scratch.mkdir(parents=True, exist_ok=True)
    component = matches.component
    with ColmapWorker(scratch) as worker:
        mapper = _Mapper(config, photos, matches, worker, scratch, reporter, threads, seed)
        best = _climb(config, mapper, prior, len(component), reporter)
        reporter.event("worker", stage="mapping", peak_rss_mb=round(worker.peak_rss_mb))
    if best is None:
        raise DataError(
            f"the matches of {len(component)} connected photos gave no reconstruction",
            hint="photos must be taken from different places (not turned on the spot) and overlap by half or more",
        )
    return Structure(
        best.reconstruction,
        best.accepted,
        best.method,
        best.agreement,
        best.compared_with,
        len(component),
        _left_out(photos.names, best.reconstruction, component, matches.edges),
    )


def _climb(
    config: StructureConfig, mapper: "_Mapper", prior: Prior, component: int, reporter: Reporter
) -> _Candidate | None:
    coarse = prior.reconstruction
    enough = config.min_registered * component
    best: _Candidate | None = None

    def judge(model: Reconstruction | None, method: str, other: Reconstruction | None, other_name: str) -> None:
        nonlocal best
        if model is None:
            return
        agreed = None if other is None else agreement(other, model)
        accepted = agreed is not None and agreed.within(config) and len(model.names) >= enough
        # Agreement on a few photos says nothing about the rest.
        accepted = accepted and agreed.common >= 0.5 * len(model.names)
        found = _Candidate(model, method, agreed, other_name, accepted)
        reporter.event(
            "mapping",
            method=method,
            registered=len(model.names),
            component=component,
            accepted=accepted,
            agreement=None if agreed is None else dataclasses.asdict(agreed),
        )
        if best is None or found.rank > best.rank:
            best = found

    if coarse is not None:
        first = mapper.triangulated(coarse, "1_triangulated")
        judge(first, "triangulated from coarse poses", coarse, "the coarse reconstruction")
        if best is not None and best.accepted and len(first.names) == component:
            return best
        if first is not None and len(first.names) < component:
            extended = mapper.incremental("2_extended", start="1_triangulated", seed_offset=0)
            if extended is not None:
                extended = mapper.triangulated(extended, "2_adjusted")
            judge(extended, "extended from coarse poses", coarse, "the coarse reconstruction")
        if best is not None and best.accepted:
            return best
    models = []
    for offset in (0, _ANOTHER_SEED):
        model = mapper.incremental(f"3_incremental_{offset}", start=None, seed_offset=offset)
        judge(model, "incremental", coarse, "the coarse reconstruction")
        if best is not None and best.accepted:
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
    photos: object
    matches: Matches
    worker: ColmapWorker
    scratch: Path
    reporter: Reporter
    threads: int
    seed: int

    def triangulated(self, poses: Reconstruction, name: str, *, refine: bool = True) -> Reconstruction | None:
        """Triangulation from poses, and unless `refine` is off two rounds of bundle adjustment and filtering."""
        narrow = {
            "max_error_px": self.config.max_error_px,
            "min_angle_deg": self.config.min_angle_deg,
            "robust": False,
            "refine": refine,
        }
        given = self.scratch / f"{name}_from"
        by_pixel_files(poses, self.photos).save(given)
        return self._model(
            name, "triangulate", poses=given, rounds=[_WIDE, narrow] if refine else [narrow], refine_intrinsics=refine
        )

    def incremental(self, name: str, *, start: str | None, seed_offset: int) -> Reconstruction | None:
        model = None if start is None else self.scratch / start / "colmap"
        return self._model(
            name,
            "map_incrementally",
            start=model,
            options={"min_num_matches": self.config.min_inliers, "min_model_size": 3},
            seed=self.seed + seed_offset,
        )

    def _model(self, name: str, job: str, **arguments) -> Reconstruction | None:
        out = self.scratch / name
        if not out.exists():
            self.worker.run(
                job,
                progress=lambda done, total: self.reporter.progress(done, total, name.split("_", 1)[1]),
                **{"seed": self.seed, **arguments},
                database=self.matches.database,
                root=self.photos.folder,
                out=out,
                threads=self.threads,
            )
        return by_photo_names(Reconstruction.load(out), self.photos) if out.exists() else None


def _left_out(
    names: tuple[str, ...], reconstruction: Reconstruction, component: np.ndarray, edges: np.ndarray
) -> tuple[tuple[str, str], ...]:
    placed, inside, matched = set(reconstruction.names), set(component.tolist()), set(np.unique(edges).tolist())
    reasons = []
    for k, name in enumerate(names):
        if name in placed:
            continue
        if k not in matched:
            reasons.append((name, "matches no other photo"))
        elif k not in inside:
            reasons.append((name, "matches only photos apart from the main group"))
        else:
            reasons.append((name, "matches, but no pose fits the rest"))
    return tuple(reasons)
