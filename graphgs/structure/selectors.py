"""Ways of choosing pairs to compare ours with. Each gives [P, 2] int, i < j, unique, sorted lexicographically."""

import numpy as np

from graphgs.scene.neighbours import nearest
from graphgs.structure.pair_set import (
    CONNECTION,
    NEIGHBOUR,
    RING,
    all_pairs,
    check_centers,
    check_rotations,
    merge_pairs,
)

_CHUNK = 1 << 20  # boxes compared at once


def exhaustive_pairs(n: int) -> np.ndarray:
    """All of them, N (N - 1) / 2."""
    return all_pairs(n)


def sequential_pairs(n: int, window: int = 5) -> np.ndarray:
    """Each camera with the next `window` in order, and with those at the powers of two beyond."""
    return merge_pairs(sequential_parts(n, window), n)[0]


def sequential_parts(n: int, window: int) -> list[tuple[np.ndarray, int]]:
    """`sequential_pairs` with the kind of each."""
    steps = {1: CONNECTION} | {step: NEIGHBOUR for step in range(2, window + 1)}
    step = 2
    while step < n:
        steps.setdefault(step, RING)
        step *= 2
    index = np.arange(n, dtype=np.int64)
    return [(np.stack([index[:-step], index[step:]], axis=1), kind) for step, kind in steps.items() if step < n]


def spatial_pairs(
    centers: np.ndarray,  # [N, 3]
    k: int,
    *,
    threads: int = 1,
) -> np.ndarray:
    """Each camera with the k nearest: what COLMAP's spatial matcher takes."""
    centers = check_centers(centers)
    near = nearest(centers, k, threads=threads)[0]
    index = np.repeat(np.arange(len(centers)), near.shape[1])
    return merge_pairs([(np.stack([index, near.ravel()], axis=1), NEIGHBOUR)], len(centers))[0]


def frustum_box_pairs(
    rotations: np.ndarray,  # [N, 3, 3] camera-from-world
    centers: np.ndarray,  # [N, 3]
    *,
    half_angle: np.ndarray,  # [N, 2] rad, horizontal and vertical
    depth_range: np.ndarray,  # [N, 2] near and far
) -> np.ndarray:
    """Pairs whose frusta have overlapping bounding boxes, sides along the WORLD's axes: the plain overlap test that
    GraphGS compares itself with. Turning the world changes the answer; all pairs are looked at."""
    centers = check_centers(centers)
    n = len(centers)
    rotations = check_rotations(rotations, n)
    slope = np.tan(half_angle)
    corners = [
        np.column_stack([u * slope[:, 0], v * slope[:, 1], np.ones(n)]) * depth_range[:, side, None]
        for side in (0, 1)
        for u in (-1, 1)
        for v in (-1, 1)
    ]
    world = np.einsum("nba,knb->kna", rotations, np.stack(corners)) + centers
    low, high = world.min(0), world.max(0)
    found = [np.zeros((0, 2), np.int64)]
    step = max(_CHUNK // max(n, 1), 1)
    for start in range(0, n, step):
        rows = np.arange(start, min(start + step, n))
        apart = (low[rows, None] > high[None]) | (high[rows, None] < low[None])
        i, j = np.nonzero(~apart.any(-1) & (rows[:, None] < np.arange(n)))
        found.append(np.stack([rows[i], j], axis=1))
    return np.concatenate(found)
