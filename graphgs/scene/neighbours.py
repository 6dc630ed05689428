"""Nearest cameras and the spacing between them: exact, ties broken by index, memory bounded."""

import numpy as np
from scipy.spatial import cKDTree

_DENSE_LIMIT = 256  # below, a full sort of each row; above, a k-d tree
_CHUNK = 1 << 21  # distances held at once
_WIDEST_TIE = 1024  # above this many equally near cameras, ties are broken by the tree and not by index
_COINCIDENT = 1e-9  # of the scene's median radius: centres closer than this are the same place


def nearest(
    centers: np.ndarray,  # [N, 3]
    k: int,
    *,
    threads: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """The k nearest OTHER cameras of each camera, nearest first, ties by index: (indices [N, K] int, distances [N, K])
    with K = min(k, N - 1)."""
    n = len(centers)
    k = max(min(k, n - 1), 0)
    if k == 0:
        return np.zeros((n, 0), np.int64), np.zeros((n, 0))
    index, distance = np.empty((n, k), np.int64), np.empty((n, k))
    if n <= _DENSE_LIMIT:
        for rows in _chunks(np.arange(n), n):
            index[rows], distance[rows] = _dense_rows(centers, rows, k)
    else:
        tree = cKDTree(centers)
        for rows in _chunks(tree.indices, k + 9):  # neighbours one after the other: their part of the tree is at hand
            index[rows], distance[rows] = _tree_rows(centers, tree, rows, k, threads)
    return index, distance


def ranked_rows(centers: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All cameras sorted by distance from each of `rows`, ties by index, the camera itself first (rank 0):
    (indices [R, N], distances [R, N], the own one -1)."""
    difference = centers[rows][:, None] - centers[None]
    distance = np.sqrt((difference * difference).sum(-1))
    distance[np.arange(len(rows)), rows] = -1.0
    order = np.argsort(distance, axis=1, kind="stable")
    return order, np.take_along_axis(distance, order, 1)


def median_spacing(centers: np.ndarray, rank: int = 5) -> float:
    """Median distance from a camera to its neighbour of that rank (the farthest there is, in smaller scenes).
    1 where it says nothing: fewer than two cameras, or most of them in one place."""
    return spacing_of(nearest(centers, rank)[1])


def spacing_of(distances: np.ndarray, rank: int = 5) -> float:
    """`median_spacing` from the distances [N, K] that `nearest` found."""
    spacing = float(np.median(distances[:, min(rank, distances.shape[1]) - 1])) if distances.size else 0.0
    return spacing if spacing > 0 else 1.0


def local_spacing(centers: np.ndarray, k: int = 5) -> np.ndarray:
    """[N] median distance of each camera to its k nearest centres in another place (rigs and stops share a place);
    1 where there is no other place."""
    n = len(centers)
    spacing = np.ones(n)
    if n < 2:
        return spacing
    radius = np.linalg.norm(centers - np.median(centers, axis=0), axis=1)
    same_place = _COINCIDENT * (float(np.median(radius)) or float(radius.max()))
    open_rows, width = np.arange(n), k
    tree = cKDTree(centers)
    while len(open_rows):
        width = min(width * 2, n - 1)
        later = []
        for rows in _chunks(open_rows, width + 9):
            distance = _tree_rows(centers, tree, rows, width, 1)[1]
            apart = distance > same_place
            enough = (apart.sum(1) >= k) | (width == n - 1)
            rank = np.cumsum(apart, axis=1)
            chosen = np.where(apart & (rank <= k), distance, np.nan)
            known = enough & apart.any(1)
            spacing[rows[known]] = np.nanmedian(chosen[known], axis=1)
            later.append(rows[~enough])
        open_rows = np.concatenate(later)
    return spacing


def _chunks(rows: np.ndarray, width: int):
    step = max(_CHUNK // max(width, 1), 1)
    return [rows[start : start + step] for start in range(0, len(rows), step)]


def _dense_rows(centers: np.ndarray, rows: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
    order, distance = ranked_rows(centers, rows)
    return order[:, 1 : k + 1], distance[:, 1 : k + 1]


def _tree_rows(
    centers: np.ndarray, tree: cKDTree, rows: np.ndarray, k: int, threads: int
) -> tuple[np.ndarray, np.ndarray]:
    """`nearest` of some rows. A row whose k-th distance is tied beyond what was queried is queried again, wider."""
    n = len(centers)
    index, distance, distinct = _untied_rows(centers, tree, rows, k, threads)
    todo, width = np.flatnonzero(~distinct), min(k + 9, n)
    while len(todo):
        own = rows[todo][:, None]
        found = tree.query(centers[rows[todo]], k=np.arange(1, width + 1), workers=threads)[1]
        lost = ~(found == own).any(1)  # more than `width` cameras in one place
        found[lost, -1] = own[lost, 0]
        found.sort(axis=1)
        difference = centers[found] - centers[own]
        length = np.sqrt((difference * difference).sum(-1))
        length[found == own] = -1.0
        order = np.argsort(length, axis=1, kind="stable")
        found, length = np.take_along_axis(found, order, 1), np.take_along_axis(length, order, 1)
        index[todo], distance[todo] = found[:, 1 : k + 1], length[:, 1 : k + 1]
        tied = length[:, k] >= length[:, -1] * (1.0 - 1e-12)
        if width >= min(n, max(_WIDEST_TIE, k + 9)):
            break
        todo, width = todo[tied], min(2 * width, n)
    return index, distance


def _untied_rows(
    centers: np.ndarray, tree: cKDTree, rows: np.ndarray, k: int, threads: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(indices [R, K], distances [R, K], [R] bool: whether no two of these distances, or the next one, are equal)."""
    length, found = tree.query(centers[rows], k=np.arange(1, k + 3), workers=threads)
    distinct = (found[:, 0] == rows) & (length[:, 1:] * (1.0 - 1e-12) > length[:, :-1]).all(1)
    found = found[:, 1 : k + 1]
    found[~distinct] = 0  # past the last camera SciPy says n
    difference = centers[found] - centers[rows][:, None]
    return found, np.sqrt((difference * difference).sum(-1)), distinct
