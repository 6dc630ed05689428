"""Final camera poses: a ladder of reconstructions, each step tried only where the one before was not accepted.

1. Triangulate the fine matches from the coarse poses, then two rounds of bundle adjustment and filtering.
2. Photos the coarse reconstruction missed: COLMAP's incremental mapper with the poses of 1 held, then 1 from its poses.
3. The incremental mapper from nothing on the same sparse graph, with two seeds, then 1 from its poses.
"""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.structure.acceptance import Agreement, agreement
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.colors import colored
from graphgs.structure.config import StructureConfig
from graphgs.structure.given import map_given
from graphgs.structure.matching import Matches
from graphgs.structure.model_calls import ModelCalls
from graphgs.structure.prior import Prior
from graphgs.structure.result import Structure, edges_among, left_out

_ANOTHER_SEED = 1000  # offset
_COMMON_SHARE = 0.5  # agreement on fewer of the photos says nothing about the rest


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
    """Climb the ladder until a reconstruction is accepted; else the best there is, not accepted. A prior of given poses
    leads to `map_given` instead.

    Each mapping call leaves its model in `scratch`: a killed run repeats at most one. Raises DataError when nothing
    could be reconstructed."""
    if prior.source == "given":
        return map_given(config, photos, matches, prior, scratch=scratch, reporter=reporter, threads=threads, seed=seed)
    component = matches.component
    with ColmapWorker(scratch) as worker:
        mapper = ModelCalls(config, photos, matches, prior, worker, scratch, reporter, threads, seed)
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
    config: StructureConfig, mapper: ModelCalls, coarse: Reconstruction | None, component: int, reporter: Reporter
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
