"""The pairing stage: from coarse poses to the pairs worth matching."""

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.progress import Reporter
from graphgs.structure.concentric import concentric_pairs
from graphgs.structure.filters import DepthRange, FieldOfView, filter_pairs
from graphgs.structure.pair_set import (
    CONNECTION,
    EXTRA,
    NEIGHBOUR,
    all_pairs,
    check_centers,
    check_pairs,
    check_rotations,
    merge_pairs,
)
from graphgs.structure.pairing_config import PairingConfig
from graphgs.structure.selectors import sequential_parts
from graphgs.structure.uncertainty import PoseUncertainty


@dataclass(frozen=True)
class Pairs:
    """Candidate pairs, with how they came about."""

    names: tuple[str, ...]  # [N] photos: those with a coarse pose first, then those without
    pairs: np.ndarray  # [P, 2] int into `names`, i < j, unique, sorted lexicographically
    kinds: np.ndarray  # [P] uint8 bits: 1 neighbour, 2 ring, 4 connection, 8 extra; 0 for exhaustive
    filtered: int  # candidates the filter dropped
    exhaustive: int  # all pairs there are: N (N - 1) / 2
    rings: str  # "paper", "geometric", or "none" where nothing concentric was made
    filter: str  # in force, "none" where nothing was filtered
    connect: str  # "sequence", "mst" or "none"

    def save(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(folder / "pairs.npz", pairs=self.pairs, kinds=self.kinds)
        header = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in ("pairs", "kinds")}
        (folder / "pairs.json").write_text(json.dumps(header, indent=1))

    @staticmethod
    def load(folder: Path) -> "Pairs":
        header = json.loads((folder / "pairs.json").read_text())
        with np.load(folder / "pairs.npz", allow_pickle=False) as arrays:
            return Pairs(names=tuple(header.pop("names")), **header, **dict(arrays))


def make_pairs(
    config: PairingConfig,
    names: Sequence[str],  # [N] photos with a coarse pose, in shooting order where `ordered`
    rotations: np.ndarray,  # [N, 3, 3] camera-from-world
    centers: np.ndarray,  # [N, 3] world
    *,
    fov_deg: FieldOfView | None = None,  # unknown: the frustum filter falls back to octant
    depth_range: DepthRange | None = None,  # of what the cameras look at; unknown: guessed from points or spacing
    points: np.ndarray | None = None,  # [K, 3] coarse points, world
    visible: np.ndarray | None = None,  # [V, 2] int: camera, point it sees
    uncertainty: PoseUncertainty | None = None,  # of the poses, for the frustum filter
    judged: np.ndarray | None = None,  # [N] bool: rotation known; pairs with other cameras are not filtered
    ordered: bool = True,  # neighbours in `names` were taken one after the other
    unplaced: Sequence[str] = (),  # [U] photos without a pose; index N + k in `extra`
    extra: np.ndarray | None = None,  # [Q, 2] int: pairs from elsewhere (retrieval), never filtered
    reporter: Reporter | None = None,
    threads: int = 1,
) -> Pairs:
    """Candidate pairs of all photos. The placed ones always form one connected graph; an unplaced one is joined only by
    what `extra` says about it (exhaustive pairs everything). The same for any number of threads."""
    reporter = reporter or Reporter()
    centers = check_centers(centers)
    n, everyone = len(centers), (*names, *unplaced)
    rotations = check_rotations(rotations, n)
    if len(names) != n:
        raise ValueError(f"names: expected {n}, as many as centers, got {len(names)}")
    extra = check_pairs(np.zeros((0, 2), int) if extra is None else extra, len(everyone), "extra")
    connect, rings, used_filter, dropped = "none", "none", "none", 0
    if config.pairs == "exhaustive":
        parts = [(all_pairs(len(everyone)), 0)]
    elif config.pairs == "graphgs" and n <= config.exhaustive_limit:
        parts = [(all_pairs(n), 0)]
    elif config.pairs == "sequential":
        parts, connect = sequential_parts(n, config.r), "sequence"
    else:
        paper = config.pairs == "paper"
        rings = "paper" if paper or n <= config.ring_limit else "geometric"
        connect = "sequence" if paper or ordered else "mst"
        pairs, kinds = concentric_pairs(
            centers, config.r, config.h, config.w, rings=rings, connect=connect, return_kinds=True,
            rotations=rotations, seed=config.seed, threads=threads,
        )  # fmt: skip
        used_filter = config.filter
        if used_filter != "none":
            # The paper exempts only the connection set; the nearest are what ties a reconstruction together locally.
            keep = (kinds & (CONNECTION if paper else CONNECTION | NEIGHBOUR)) != 0
            if judged is not None:
                keep |= ~judged[pairs].all(1)
            keep[~keep] = filter_pairs(
                pairs[~keep], rotations, centers, mode=config.filter, fov_deg=fov_deg, depth_range=depth_range,
                points=points, visible=visible, uncertainty=uncertainty,
            )  # fmt: skip
            if not paper:
                keep |= _rescued(pairs, keep, centers, config.least_per_camera)
            dropped = int((~keep).sum())
            pairs, kinds = pairs[keep], kinds[keep]
        parts = [(pairs, kinds)]
    pairs, kinds = merge_pairs([*parts, (extra, EXTRA)], len(everyone))
    exhaustive = len(everyone) * (len(everyone) - 1) // 2
    reporter.event("pairs", candidates=len(pairs), exhaustive=exhaustive, filtered=dropped, rings=rings)
    share = f" ({100 * len(pairs) / exhaustive:.0f} %)" if exhaustive else ""
    reporter.info(f"pairs: {len(pairs)} of {exhaustive}{share}, {dropped} dropped by the {used_filter} filter")
    return Pairs(everyone, pairs, kinds, dropped, exhaustive, rings, used_filter, connect)


def _rescued(pairs: np.ndarray, keep: np.ndarray, centers: np.ndarray, least: int) -> np.ndarray:
    """[P] bool: dropped pairs to take back, the shortest first, so that no camera has fewer than `least`."""
    missing = np.maximum(least - np.bincount(pairs[keep].ravel(), minlength=len(centers)), 0)
    back = np.zeros(len(pairs), bool)
    dropped = np.flatnonzero(~keep & (missing[pairs] > 0).any(1))
    length = np.linalg.norm(centers[pairs[dropped, 0]] - centers[pairs[dropped, 1]], axis=1)
    for p in dropped[np.argsort(length, kind="stable")]:
        i, j = pairs[p]
        if missing[i] > 0 or missing[j] > 0:
            back[p] = True
            missing[i] -= 1
            missing[j] -= 1
    return back
