"""Rings of doubling rank: long-range pairs whose number grows with log N per camera instead of N.

The exact camera of rank 2^k needs all distances. Instead, at level k all cameras are dealt into 2^k random parts of
m = N / 2^k, and each pairs with the nearest of its own part: a camera of rank around 2^k. Taking the camera's own part,
and not one subset for all, bounds how many cameras can choose the same partner (there are no hubs), and half of the
choices are mutual, so the pairs number less than one per camera and level.
"""

import numpy as np
from scipy.spatial import cKDTree

_SMALL_PART = 64  # parts up to this size are compared all with all
_WORTH_THREADS = 20_000  # cameras; below, starting a thread takes longer than the search
_CHUNK = 1 << 17  # distances held at once: they stay in the processor's cache


def geometric_ring_pairs(
    centers: np.ndarray,  # [N, 3]
    *,
    seed: int = 0,
    threads: int = 1,
) -> np.ndarray:
    """[P, 2] int: for m = N/2, N/4, ... 2, each camera with the nearest one of its random part of m; any order,
    with duplicates. The same for any number of threads."""
    n = len(centers)
    found = [np.zeros((0, 2), np.int64)]
    by_place = cKDTree(centers).indices if n else np.zeros(0, np.int64)  # cameras, near ones side by side
    place = np.empty(n, np.int64)
    place[by_place] = np.arange(n)
    count = 2
    while 2 * count <= n:
        m = -(-n // count)
        order = np.random.default_rng([seed, count]).permutation(n)
        if m <= _SMALL_PART:
            found.append(_nearest_in_small_parts(centers, order, m))
        else:
            # A search that follows its neighbours finds their part of the tree at hand: 2 to 4 times faster.
            parts = (by_place[np.sort(place[order[start : start + m]])] for start in range(0, n, m))
            found += [_nearest_in_part(centers, part, threads) for part in parts if len(part) > 1]
        count *= 2
    return np.concatenate(found)


def _nearest_in_part(centers: np.ndarray, part: np.ndarray, threads: int) -> np.ndarray:
    points = centers[part]
    workers = threads if len(part) > _WORTH_THREADS else 1
    found = cKDTree(points, balanced_tree=False).query(points, k=2, workers=workers)[1]
    own = np.arange(len(part))
    other = np.where(found[:, 0] == own, found[:, 1], found[:, 0])  # the own one need not come first in a shared place
    return np.stack([part, part[other]], axis=1)


def _nearest_in_small_parts(centers: np.ndarray, order: np.ndarray, m: int) -> np.ndarray:
    n = len(order)
    parts = np.full(-(-n // m) * m, -1)
    parts[:n] = order
    parts = parts.reshape(-1, m)
    pairs = []
    step = max(_CHUNK // (m * m), 1)
    for start in range(0, len(parts), step):
        part = parts[start : start + step]
        distance = np.zeros((len(part), m, m))
        for axis in centers.T:
            along = axis[part]
            distance += (along[:, :, None] - along[:, None]) ** 2
        empty = part < 0
        distance[np.broadcast_to(empty[:, None], distance.shape)] = np.inf
        distance[:, np.arange(m), np.arange(m)] = np.inf
        nearest = distance.argmin(-1)
        alone = empty | ~np.isfinite(distance.min(-1))
        pair = np.stack([part, np.take_along_axis(part, nearest, 1)], axis=-1)
        pairs.append(pair[~alone])
    return np.concatenate(pairs)
