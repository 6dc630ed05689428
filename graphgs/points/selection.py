"""Which octree nodes become one point each: a level of detail per node, and the lowest merged first."""

import io
import os
from contextlib import redirect_stdout
from dataclasses import dataclass

import numpy as np

from graphgs.points.frame import BITS, SIDE, morton

COARSEST = 4  # level of the cells that are never emptied: 16 per axis, 8 over the core; fewer for a small target
ERROR_UNIT = 1024  # fixed point steps per pixel


@dataclass(frozen=True)
class Nodes:
    """All occupied cells, sorted by level and Morton code; so the children of a node are neighbours, and so are its
    points when points are sorted by Morton code."""

    levels: np.ndarray  # [M]
    parents: np.ndarray  # [M] index of the parent, -1 for the root
    firsts: np.ndarray  # [M] first point
    counts: np.ndarray  # [M] points
    children: np.ndarray  # [M] child nodes; points for a leaf
    lods: np.ndarray  # [M] level of detail, never below a child's


@dataclass(frozen=True)
class Merge:
    """Runs of points that become one, by increasing first point."""

    firsts: np.ndarray  # [G]
    counts: np.ndarray  # [G]
    levels: np.ndarray  # [G] of the node merged
    coarse: int  # level of the cells that keep a point


def build_nodes(
    coordinates: np.ndarray,  # [N, 3] int64 quantised, sorted by Morton code
    errors: np.ndarray,  # [N] px
    track_lengths: np.ndarray,  # [N]
    *,
    threads: int,
) -> Nodes:
    """The octree over all points, with the level of detail that `prune_octree` explains."""
    os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "False")  # a greeting on stdout when imported
    from graphgs.kernels.octree import DEPTH, sparse_octree

    with redirect_stdout(io.StringIO()):  # another one when started
        octree = sparse_octree(threads=threads)
    cells = (coordinates >> (BITS - DEPTH)).astype(np.int32)
    with octree as tree:
        nodes = tree.insert(cells)
        codes = morton(nodes[:, 1:])
        order = np.lexsort((codes, nodes[:, 0]))
        nodes, codes = np.ascontiguousarray(nodes[order]), codes[order]
        fixed = np.round(np.minimum(errors, 1e6) * ERROR_UNIT).astype(np.int64)
        sums = tree.accumulate(nodes, cells, coordinates, fixed, np.round(track_lengths).astype(np.int64))

    levels = nodes[:, 0]
    starts = np.searchsorted(levels, np.arange(DEPTH + 2))
    parents = np.full(len(nodes), -1)
    firsts = np.zeros(len(nodes), np.int64)
    points = morton(cells)
    for level in range(DEPTH + 1):
        own = slice(starts[level], starts[level + 1])
        firsts[own] = np.searchsorted(points >> (3 * (DEPTH - level)), codes[own])
        if level > 0:
            above = slice(starts[level - 1], starts[level])
            parents[own] = starts[level - 1] + np.searchsorted(codes[above], codes[own] >> 3)
    children = np.bincount(parents[1:], minlength=len(nodes))
    children[starts[DEPTH] :] = sums.counts[starts[DEPTH] :]

    extent = np.sqrt(((sums.highs - sums.lows) ** 2).sum(1).astype(float)) * (SIDE / 2.0**BITS)
    mean_error = sums.errors / (ERROR_UNIT * sums.counts)
    mean_track = sums.tracks / sums.counts
    lods = extent / np.sqrt(sums.counts) / (1.0 + mean_error / np.sqrt(np.maximum(mean_track, 1.0)))
    for level in range(DEPTH, 0, -1):
        own = slice(starts[level], starts[level + 1])
        np.maximum.at(lods, parents[own], lods[own])
    return Nodes(levels, parents, firsts, sums.counts, children, lods)


def select(nodes: Nodes, *, target: int | None, tau: float | None) -> Merge:
    """Merge from the lowest level of detail up: until `target` points are left, or all nodes below `tau` are merged.

    The last node may be merged in part, which is how the target is met exactly. Cells of the coarse level keep a point.
    """
    total = int(nodes.counts[0])
    coarse = COARSEST
    if target is not None:
        occupied = np.bincount(nodes.levels, minlength=COARSEST + 1)
        while coarse > 0 and occupied[coarse] > target // 4:
            coarse -= 1
    candidates = np.nonzero(nodes.levels >= coarse)[0]
    # A child comes before its parent: its level of detail is no higher and, where equal, its level is deeper.
    order = candidates[np.lexsort((candidates, -nodes.levels[candidates], nodes.lods[candidates]))]
    left = total - np.cumsum(nodes.children[order] - 1)

    partial = None
    if tau is not None:
        taken = order[nodes.lods[order] < tau]
    elif target is None or target >= total:
        taken = order[:0]
    else:
        last = int(np.argmax(left <= target))
        taken = order[: last + 1] if left[last] == target else order[:last]
        if left[last] < target:
            before = total if last == 0 else int(left[last - 1])
            partial = (int(order[last]), before - target + 1)  # the node and how many of its children join

    merged = np.zeros(len(nodes.levels), bool)
    merged[taken] = True
    tops = np.nonzero(merged & ~((nodes.parents >= 0) & merged[nodes.parents]) & (nodes.counts > 1))[0]
    firsts, counts, levels = nodes.firsts[tops], nodes.counts[tops], nodes.levels[tops]
    if partial is not None:
        first, count, level = _part_of(nodes, *partial)
        outside = (firsts < first) | (firsts >= first + count)
        firsts = np.append(firsts[outside], first)
        counts = np.append(counts[outside], count)
        levels = np.append(levels[outside], level)
    by_first = np.argsort(firsts)
    return Merge(firsts[by_first], counts[by_first], levels[by_first], coarse)


def _part_of(nodes: Nodes, node: int, joining: int) -> tuple[int, int, int]:
    """(first point, points, level) of the first `joining` children of a node, or points of a leaf."""
    first, level = int(nodes.firsts[node]), int(nodes.levels[node])
    below = np.nonzero(nodes.parents == node)[0]
    count = int(nodes.counts[below[:joining]].sum()) if len(below) else joining
    return first, count, level
