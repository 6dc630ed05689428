"""Octree pruning of a point cloud: fewer points where they crowd, none lost where they are rare.

GraphGS (ICLR 2025), section 3: nodes whose level of detail falls below tau are pruned. The paper gives neither the
formula nor tau nor the depth; the ones here are ours (docs/decisions/0014-octree.md).
"""

import numpy as np
from scipy.spatial import cKDTree

from graphgs.points.frame import BITS, Frame, morton
from graphgs.points.pruned import PrunedPoints
from graphgs.points.selection import Merge, build_nodes, select
from graphgs.threads import get_num_threads

MAX_POINTS = 2**25  # weights (10 bits) x coordinates (28 bits) x points must fit a 64-bit sum
WEIGHT_UNIT = 64  # fixed point weight of a point as good as the median
WEIGHT_MAX = 1023
COLOR_UNIT = 65535
NEIGHBORS = 3  # 3DGS, Kerbl et al. 2023: a Gaussian starts as large as the mean distance to its 3 nearest


def prune_octree(
    positions: np.ndarray,  # [N, 3] world
    colors: np.ndarray,  # [N, 3] RGB, uint8 or float in 0..1
    *,
    errors: np.ndarray | None = None,  # [N] mean reprojection error, px; None = all equal
    track_lengths: np.ndarray | None = None,  # [N] observations; None = all equal
    target: int | None = None,  # points wanted
    tau: float | None = None,  # level of detail below which a node becomes one point
    threads: int | None = None,  # None = graphgs.set_num_threads; Taichi keeps the number of its first call
) -> PrunedPoints:
    """Merge points from the bottom of an octree up, to a target number or to a level of detail.

    The level of detail of a node with n points is

        lod = extent / sqrt(n) / (1 + mean error / sqrt(mean track length))

    and never below that of a child. extent is the diagonal of the box around the node's points, in half sides of the
    octree's core (`Frame`), so extent / sqrt(n) is about the spacing of n points on a surface: how fine the detail is
    that they resolve. A point seen L times with error e is known to about e / sqrt(L) px, so the last factor, between
    0 and 1, takes away what the points only pretend to resolve. Low values are crowded or vague points, and one point
    can stand for them. Exact duplicates have 0 and go first; a lone point costs nothing and is never touched.

    With `target`, nodes merge in order of lod until exactly that many points are left; a target of N or more keeps
    every point, duplicates included. With `tau`, all nodes below it merge. With neither, all points stay. An occupied
    coarse cell (level 4 of the octree, or the finest level with at most target / 4 occupied cells) always keeps one.

    A merged point has the weighted mean position and colour of its members, weight L / (1 + e^2); far outside the core
    the mean is taken in contracted space, which keeps it within its cell. Its scale is the mean distance to its three
    nearest neighbours, but no less than its members' reach (half the box around them, at most half its cell) and no
    more than the side of a coarse cell. The result does not depend on the order of the points: output points come in
    Morton order.

    Raises ValueError for wrong shapes, values that are not finite, no points, or both `target` and `tau`.
    """
    positions, colors, errors, track_lengths = _checked(positions, colors, errors, track_lengths)
    if target is not None and tau is not None:
        raise ValueError("target, tau: expected one of them, got both")
    if target is not None and target < 1:
        raise ValueError(f"target: expected at least 1, got {target}")
    if tau is not None and not tau >= 0:
        raise ValueError(f"tau: expected 0 or more, got {tau}")

    frame = Frame.around(positions)
    coordinates = frame.quantize(positions)
    keys = (track_lengths, errors, *colors.T[::-1], *positions.T[::-1], morton(coordinates >> (BITS - 21)))
    order = np.lexsort(keys)  # by place; then by everything else that could tell two points apart
    nodes = build_nodes(coordinates[order], errors[order], track_lengths[order], threads=threads or get_num_threads())
    merge = select(nodes, target=target, tau=tau)

    count = len(positions)
    starts = np.ones(count, bool)
    starts[_members(merge)] = False
    starts[merge.firsts] = True
    firsts = np.nonzero(starts)[0]
    group = np.cumsum(starts) - 1  # [N] output point of each sorted point
    outputs = group[merge.firsts]

    weights = _weights(errors, track_lengths)[order]
    merged_positions, merged_colors = positions[order][firsts], colors[order][firsts]
    merged_positions[outputs], low, high = _mean_positions(frame, positions[order], coordinates[order], weights, merge)
    merged_colors[outputs] = _mean_colors(colors[order], weights, merge)

    reach = np.zeros(len(firsts))
    reach[outputs] = 0.5 * np.minimum(
        np.linalg.norm(high - low, axis=1), frame.cell_size(merged_positions[outputs], merge.levels)
    )
    scales = np.clip(neighbor_distance(merged_positions), reach, frame.cell_size(merged_positions, merge.coarse))
    representative = np.empty(count, np.int64)
    representative[order] = group
    moved = np.linalg.norm(positions - merged_positions[representative], axis=1)
    return PrunedPoints(merged_positions, merged_colors, scales, representative, float(moved.max()))


def keep_all(
    positions: np.ndarray,  # [N, 3] world
    colors: np.ndarray,  # [N, 3] RGB, uint8 or float in 0..1
) -> PrunedPoints:
    """Every point as it is, in its order; scales from the three nearest neighbours."""
    positions, colors, *_ = _checked(positions, colors, None, None)
    return PrunedPoints(positions, colors, neighbor_distance(positions), np.arange(len(positions)), 0.0)


def neighbor_distance(
    positions: np.ndarray,  # [M, 3] world
) -> np.ndarray:
    """[M] mean distance to the three nearest other points; never zero, also among duplicates or for a lone point."""
    spread = Frame.around(positions).half
    if len(positions) == 1:
        return np.full(1, 0.01 * spread)
    near, _ = cKDTree(positions).query(positions, k=min(NEIGHBORS + 1, len(positions)))
    return np.maximum(near[:, 1:].mean(1), 1e-5 * spread)


def _members(merge: Merge) -> np.ndarray:
    """Sorted points of all merged runs."""
    within = np.arange(merge.counts.sum()) - np.repeat(np.cumsum(merge.counts) - merge.counts, merge.counts)
    return np.repeat(merge.firsts, merge.counts) + within


def _weights(errors: np.ndarray, track_lengths: np.ndarray) -> np.ndarray:
    """[N] int64, 1 .. WEIGHT_MAX, in proportion to L / (1 + e^2); the 1 keeps a lucky point from ruling the others."""
    raw = np.maximum(track_lengths, 1.0) / (1.0 + np.minimum(errors, 1e6) ** 2)
    return np.clip(np.round(WEIGHT_UNIT * raw / np.median(raw)), 1, WEIGHT_MAX).astype(np.int64)


def _sums(values: np.ndarray, merge: Merge) -> np.ndarray:
    """Sums of integer rows over each merged run, exact in any order."""
    total = np.zeros((len(values) + 1, *values.shape[1:]), np.int64)
    np.cumsum(values, axis=0, out=total[1:])
    return total[merge.firsts + merge.counts] - total[merge.firsts]


def _mean_positions(frame: Frame, positions, coordinates, weights, merge) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """([G, 3] weighted means, [G, 3] lowest, [G, 3] highest corner of the members), world."""
    mean = _sums(coordinates * weights[:, None], merge) / _sums(weights, merge)[:, None]
    if len(merge.firsts) == 0:
        return mean, mean, mean
    members, starts = positions[_members(merge)], np.cumsum(merge.counts) - merge.counts
    low, high = np.minimum.reduceat(members, starts), np.maximum.reduceat(members, starts)
    return np.clip(frame.positions(mean), low, high), low, high  # the quantisation step must not carry it outside


def _mean_colors(colors, weights, merge) -> np.ndarray:
    """[G, 3] weighted mean colours in the input's type."""
    bytes_in = colors.dtype == np.uint8
    fixed = colors.astype(np.int64) if bytes_in else np.round(colors * float(COLOR_UNIT)).astype(np.int64)
    total = _sums(weights, merge)[:, None]
    mean = _sums(fixed * weights[:, None], merge) / total
    return np.round(mean).astype(np.uint8) if bytes_in else (mean / COLOR_UNIT).astype(colors.dtype)


def _checked(positions, colors, errors, track_lengths):
    """The arguments as contiguous arrays, or ValueError naming the one that is wrong."""
    positions = np.array(positions, dtype=np.float64)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise ValueError(f"positions: expected [N, 3], got {list(positions.shape)}")
    count = len(positions)
    if count == 0:
        raise ValueError("positions: expected at least one point, got none")
    if count > MAX_POINTS:
        raise ValueError(f"positions: expected at most {MAX_POINTS} points, got {count}")
    colors = np.array(colors)
    if colors.dtype != np.uint8:
        colors = colors.astype(np.float32 if colors.dtype == np.float32 else np.float64)
    errors = np.zeros(count) if errors is None else np.array(errors, dtype=np.float64)
    track_lengths = np.ones(count) if track_lengths is None else np.array(track_lengths, dtype=np.float64)
    for name, value, shape in (
        ("colors", colors, (count, 3)),
        ("errors", errors, (count,)),
        ("track_lengths", track_lengths, (count,)),
    ):
        if value.shape != shape:
            raise ValueError(f"{name}: expected {list(shape)}, got {list(value.shape)}")
    arrays = {"positions": positions, "colors": colors, "errors": errors, "track_lengths": track_lengths}
    for name, value in arrays.items():
        if not np.isfinite(value).all():
            row = int(np.nonzero(~np.isfinite(value).reshape(count, -1).all(1))[0][0])
            raise ValueError(f"{name}: expected finite values, row {row} has {value[row]}")
    if (errors < 0).any() or (track_lengths < 0).any():
        raise ValueError("errors, track_lengths: expected 0 or more")
    return positions, colors, errors, track_lengths
