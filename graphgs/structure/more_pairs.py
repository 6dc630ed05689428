"""Further pairs for matches that gave no reconstruction to be accepted."""

import dataclasses

import numpy as np

from graphgs.progress import Reporter
from graphgs.structure.candidates import candidate_pairs
from graphgs.structure.database import copy_whole
from graphgs.structure.matching import Matches, in_photo_order, match_and_verify
from graphgs.structure.model_calls import ModelCalls
from graphgs.structure.pair_set import all_pairs
from graphgs.structure.pairing_config import PairingConfig
from graphgs.structure.prior import Prior

_NEAREST = 10  # cameras


def wider_pairs(prior: Prior) -> list[tuple[int, int]]:
    """Twice the usual number of nearest cameras, and every look-alike there is: the poses may be what is wrong."""
    near = candidate_pairs(PairingConfig(r=_NEAREST), prior, reporter=Reporter(), threads=1)
    alike = prior.similar_pairs(np.arange(len(prior.names)))
    return sorted({*in_photo_order(near, prior.names), *map(tuple, alike.tolist())})


def every_pair(prior: Prior) -> list[tuple[int, int]]:
    return [(int(i), int(j)) for i, j in all_pairs(len(prior.names))]


def with_more_pairs(calls: ModelCalls, name: str, pairs: list[tuple[int, int]]) -> ModelCalls | None:
    """The same calls with these pairs matched too, and a scratch folder of their own; None if no new pair verifies."""
    scratch = calls.scratch / name
    scratch.mkdir(parents=True, exist_ok=True)
    database = scratch / "database.db"
    names, crashes = calls.matches.names, calls.matches.crashes
    pairs = [(i, j) for i, j in pairs if not any(crash.concerns(names[i], names[j]) for crash in crashes)]
    if not database.exists():
        copy_whole(calls.matches.database, database)
    edges, inliers, further = match_and_verify(
        calls.worker,
        database,
        names,
        pairs,
        calls.config,
        progress=lambda done, total: calls.reporter.progress(done, total, "more pairs"),
        threads=calls.threads,
        seed=calls.seed,
    )
    known = len(calls.matches.edges)
    calls.reporter.event("more_pairs", name=name, candidates=len(pairs), verified=len(edges), before=known)
    if len(edges) == known:
        return None
    candidates = calls.matches.candidates + len(pairs)
    matches = Matches(names, database, edges, inliers, calls.matches.features, candidates, crashes=crashes + further)
    return dataclasses.replace(calls, matches=matches, scratch=scratch)
