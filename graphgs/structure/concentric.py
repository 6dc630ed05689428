"""Concentric nearest neighbour pairing (GraphGS, section 3.1): every camera with its r nearest, with a few cameras of
every ring of ranks further out, and with a connection set that keeps the whole in one piece."""

from typing import Literal

import numpy as np

from graphgs.scene.neighbours import nearest, ranked_rows
from graphgs.structure.connection import sequence_pairs, spanning_tree
from graphgs.structure.pair_set import CONNECTION, NEIGHBOUR, RING, check_centers, check_rotations, merge_pairs
from graphgs.structure.rings import geometric_ring_pairs

_CHUNK = 1 << 21  # distances held at once


def concentric_ranks(n: int, r: int = 5, h: int = 20, w: int = 1) -> np.ndarray:
    """[K] int: the ranks (nearest other camera = 1) each of n cameras pairs with in the literal form,
    `s <= r or 0 <= (s - r) mod (h + w) < w`: 33 of them for n = 600, 99 for n = 2000."""
    if r < 0 or h < 0 or w < 0 or h + w < 1:
        raise ValueError(f"r, h, w: expected r, h, w >= 0 and h + w >= 1, got r={r}, h={h}, w={w}")
    rank = np.arange(1, max(n, 1))
    return rank[(rank <= r) | ((rank - r) % (h + w) < w)]


def concentric_pairs(
    centers: np.ndarray,  # [N, 3] world
    r: int = 5,  # nearest cameras taken
    h: int = 20,  # ranks skipped per ring
    w: int = 1,  # ranks taken per ring
    *,
    rings: Literal["paper", "geometric"] = "paper",
    connect: Literal["sequence", "mst"] | None = "sequence",
    return_kinds: bool = False,
    rotations: np.ndarray | None = None,  # [N, 3, 3] camera-from-world; lets "mst" prefer overlapping views
    seed: int = 0,  # of the geometric rings' subsets
    threads: int = 1,
) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
    """Candidate pairs [P, 2] int, i < j, unique, sorted lexicographically; with `return_kinds` also kinds [P] uint8
    (bits 1 neighbour, 2 ring, 4 connection, united over both orders of a pair).

    rings="paper" is the printed definition: N (r + (N - r - 1) w / (h + w)) ordered pairs, so O(N^2) of them, found in
    O(N) memory beyond the result. rings="geometric" departs from the paper: the r nearest exactly, then one camera per
    ring whose ranks double (`rings.py`), O(N log N) pairs; h and w have no effect.
    connect="sequence" adds the paper's (i - 1, i); "mst" a spanning tree for photos in no meaningful order; with either
    the pairs always form one connected graph. Ties in distance are broken by index; scaling, rotating or moving the
    cameras changes nothing (up to such ties).
    Raises ValueError for centres that are not finite.
    """
    centers = check_centers(centers)
    n = len(centers)
    ranks = concentric_ranks(n, r, h, w)
    if rings == "paper":
        parts = _literal_parts(centers, ranks, r, n)
    elif rings == "geometric":
        parts = [(_as_pairs(nearest(centers, r, threads=threads)[0]), NEIGHBOUR)]
        parts += [(geometric_ring_pairs(centers, seed=seed, threads=threads), RING)]
    else:
        raise ValueError(f"rings: expected 'paper' or 'geometric', got {rings!r}")
    if connect == "sequence":
        parts.append((sequence_pairs(n), CONNECTION))
    elif connect == "mst":
        if rotations is not None:
            rotations = check_rotations(rotations, n)
        parts.append((spanning_tree(centers, rotations, threads=threads), CONNECTION))
    elif connect is not None:
        raise ValueError(f"connect: expected 'sequence', 'mst' or None, got {connect!r}")
    pairs, kinds = merge_pairs(parts, n)
    return (pairs, kinds) if return_kinds else pairs


def _literal_parts(centers: np.ndarray, ranks: np.ndarray, r: int, n: int) -> list[tuple[np.ndarray, np.ndarray]]:
    parts = []
    step = max(_CHUNK // max(n, 1), 1)
    kind_of_rank = np.where(ranks <= r, NEIGHBOUR, RING).astype(np.uint8)
    for start in range(0, n, step):
        rows = np.arange(start, min(start + step, n))
        taken = ranked_rows(centers, rows)[0][:, ranks]
        pairs = np.stack([np.repeat(rows, len(ranks)), taken.ravel()], axis=1)
        parts.append((pairs, np.tile(kind_of_rank, len(rows))))
    return parts


def _as_pairs(neighbours: np.ndarray) -> np.ndarray:
    """[N * K, 2] from [N, K] neighbour indices."""
    n, k = neighbours.shape
    return np.stack([np.repeat(np.arange(n), k), neighbours.ravel()], axis=1)
