"""Octree pruning written for reading: cells are dictionary keys, sums are Python integers, one merge at a time."""

import math
from dataclasses import dataclass

import numpy as np

LEAF, BITS, COARSEST = 9, 28, 4


@dataclass
class Pruned:
    positions: np.ndarray
    colors: np.ndarray
    scales: np.ndarray
    representative: np.ndarray
    coverage: float


def prune(positions, colors, errors, track_lengths, *, target=None, tau=None) -> Pruned:
    """What `graphgs.points.prune_octree` computes, for uint8 colours."""
    center, half = _core(positions)
    quantized = [_quantize((p - center) / half) for p in positions]

    def place(p):  # bits of x, y, z in turn, the highest first; then whatever else tells two points apart
        bits = [(quantized[p][axis] >> bit) & 1 for bit in range(BITS - 1, BITS - 22, -1) for axis in range(3)]
        return (bits, *positions[p], *colors[p], errors[p], track_lengths[p])

    order = sorted(range(len(positions)), key=place)
    cells: dict[tuple, list[int]] = {}  # (level, x, y, z) -> points, in order
    for p in order:
        for level in range(LEAF + 1):
            cells.setdefault((level, *(c >> (BITS - level) for c in quantized[p])), []).append(p)

    lods = {}
    for cell in sorted(cells, key=lambda c: -c[0]):
        children = [lods[child] for child in _children(cells, cell)]
        lods[cell] = max([_lod(quantized, errors, track_lengths, cells[cell]), *children])

    coarse = COARSEST
    while target is not None and coarse > 0 and sum(c[0] == coarse for c in cells) > target // 4:
        coarse -= 1
    rank = {p: k for k, p in enumerate(order)}
    queue = sorted((c for c in cells if c[0] >= coarse), key=lambda c: (lods[c], -c[0], rank[cells[c][0]]))
    group = {p: [p] for p in order}  # every point's fellow members
    level_of = {p: LEAF for p in order}
    left = len(order)
    for cell in queue:
        if (tau is None and (target is None or left <= target)) or (tau is not None and lods[cell] >= tau):
            break
        parts = [cells[c] for c in _children(cells, cell)] or [[p] for p in cells[cell]]
        if target is not None:
            parts = parts[: left - target + 1]
        members = [p for part in parts for p in part]
        left -= len(parts) - 1
        for p in members:
            group[p], level_of[p] = members, cell[0]

    firsts = [p for p in order if group[p][0] == p]
    output = {p: k for k, p in enumerate(firsts)}
    representative = np.array([output[group[p][0]] for p in range(len(positions))])
    raw = [max(L, 1.0) / (1.0 + e * e) for L, e in zip(track_lengths, errors, strict=True)]
    weights = [min(max(round(64 * r / float(np.median(raw))), 1), 1023) for r in raw]

    merged, merged_colors, reach = [], [], []
    for first in firsts:
        members = group[first]
        low, high = positions[members].min(0), positions[members].max(0)
        if len(members) == 1:
            merged.append(positions[first])
            merged_colors.append(colors[first])
            reach.append(0.0)
            continue
        total = sum(weights[p] for p in members)
        mean = [sum(weights[p] * quantized[p][axis] for p in members) / total for axis in range(3)]
        merged.append(np.clip(_world(mean, center, half), low, high))
        merged_colors.append([round(sum(weights[p] * int(colors[p][k]) for p in members) / total) for k in range(3)])
        cell_size = _cell_size(merged[-1], level_of[first], center, half)
        reach.append(0.5 * min(np.linalg.norm(high - low), cell_size))
    merged = np.array(merged)
    scales = [
        min(max(_near(merged, k, half), reach[k]), _cell_size(merged[k], coarse, center, half))
        for k in range(len(merged))
    ]
    moved = np.linalg.norm(positions - merged[representative], axis=1).max()
    return Pruned(merged, np.array(merged_colors, np.uint8), np.array(scales), representative, float(moved))


def _core(positions):
    center = np.median(positions, axis=0)
    spread = np.abs(np.quantile(positions, (0.02, 0.98), axis=0) - center).max()
    spread = spread or np.abs(positions - center).max()
    return center, 1.1 * spread or 1.0


def _quantize(local) -> tuple[int, int, int]:
    radius = max(1.0, np.abs(local).max())
    contracted = local * ((2.0 - 1.0 / radius) / radius)
    return tuple(min(max(math.floor((c / 4.0 + 0.5) * 2.0**BITS), 0), 2**BITS - 1) for c in contracted)


def _world(quantized, center, half):
    contracted = [((q + 0.5) / 2.0**BITS - 0.5) * 4.0 for q in quantized]
    radius = max(map(abs, contracted))
    stretch = 1.0 / (radius * (2.0 - radius)) if radius > 1.0 else 1.0
    return center + half * stretch * np.array(contracted)


def _cell_size(position, level, center, half) -> float:
    radius = max(1.0, np.abs((position - center) / half).max())
    return 4.0 * half * 2.0**-level * radius * radius / (2.0 * radius - 1.0)


def _children(cells, cell) -> list[tuple]:
    level, x, y, z = cell
    corners = [(level + 1, 2 * x + a, 2 * y + b, 2 * z + c) for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    return [corner for corner in corners if corner in cells]


def _lod(quantized, errors, track_lengths, members) -> float:
    q = np.array([quantized[p] for p in members])
    extent = math.sqrt(float(((q.max(0) - q.min(0)) ** 2).sum())) * (4.0 / 2.0**BITS)
    mean_error = sum(round(1024 * errors[p]) for p in members) / (1024 * len(members))
    mean_track = sum(round(track_lengths[p]) for p in members) / len(members)
    return extent / math.sqrt(len(members)) / (1.0 + mean_error / math.sqrt(max(mean_track, 1.0)))


def _near(points, k, half) -> float:
    """Mean distance to the three nearest others. `half` is the core's before merging; a lone point needs none of it."""
    if len(points) == 1:
        return 0.01
    distances = np.sort(np.linalg.norm(np.delete(points, k, axis=0) - points[k], axis=1))[:3]
    return max(float(distances.mean()), 1e-5 * _core(points)[1])
