"""Pairs that keep the candidate graph in one piece: the sequence, or a spanning tree where photos have no order."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

from graphgs.scene.neighbours import nearest, spacing_of
from graphgs.structure.pair_set import merge_pairs

_NEIGHBOURS = 16  # the tree is searched among these links of each camera first


def sequence_pairs(n: int) -> np.ndarray:
    """[N - 1, 2]: each camera with the one before it (GraphGS: the connection set)."""
    index = np.arange(max(n - 1, 0), dtype=np.int64)
    return np.stack([index, index + 1], axis=1)


def spanning_tree(
    centers: np.ndarray,  # [N, 3]
    rotations: np.ndarray | None = None,  # [N, 3, 3] camera-from-world
    *,
    threads: int = 1,
) -> np.ndarray:
    """[N - 1, 2] int: a tree over all cameras with small total cost, where a link costs its length in median spacings
    plus 1 - cos of the angle between the viewing directions (how far apart the views are; 0 without rotations).

    Exact up to 17 cameras; above, the minimum forest among each camera's 16 nearest, whose components are then joined
    by the shortest links between them (Boruvka): O(N log N) per round."""
    n = len(centers)
    if n < 2:
        return np.zeros((0, 2), np.int64)
    near, distances = nearest(centers, _NEIGHBOURS, threads=threads)
    links = np.stack([np.repeat(np.arange(n), near.shape[1]), near.ravel()], axis=1)
    links = merge_pairs([(links, 0)], n)[0]
    spacing = spacing_of(distances)
    tree = _forest(links, _cost(links, centers, rotations, spacing), n)
    while True:
        count, component = connected_components(_adjacency(tree, np.ones(len(tree)), n), directed=False)
        if count == 1:
            return tree[np.lexsort((tree[:, 1], tree[:, 0]))]
        bridges = _shortest_bridges(centers, component, count)
        tree = _forest(np.concatenate([tree, bridges]), np.r_[np.zeros(len(tree)), _length(bridges, centers)], n)


def _cost(links: np.ndarray, centers: np.ndarray, rotations: np.ndarray | None, spacing: float) -> np.ndarray:
    cost = _length(links, centers) / spacing
    if rotations is not None:
        direction = rotations[:, 2]
        cost = cost + 1.0 - (direction[links[:, 0]] * direction[links[:, 1]]).sum(1)
    return cost


def _length(links: np.ndarray, centers: np.ndarray) -> np.ndarray:
    return np.linalg.norm(centers[links[:, 0]] - centers[links[:, 1]], axis=1)


def _forest(links: np.ndarray, cost: np.ndarray, n: int) -> np.ndarray:
    """[T, 2] the links of a minimum spanning forest. One is added to each cost, because SciPy reads 0 as no link;
    it changes no tree."""
    kept = minimum_spanning_tree(_adjacency(links, cost + 1.0, n)).tocoo()
    return np.sort(np.stack([kept.row, kept.col], axis=1).astype(np.int64), axis=1)


def _adjacency(links: np.ndarray, weight: np.ndarray, n: int):
    return coo_matrix((weight, (links[:, 0], links[:, 1])), shape=(n, n)).tocsr()


def _shortest_bridges(centers: np.ndarray, component: np.ndarray, count: int) -> np.ndarray:
    """[count, 2] the shortest link out of each component. Two components differ in some bit of their number, so the
    nearest foreign camera is the nearest over all bits among the cameras whose bit differs: log2(count) tree pairs."""
    n = len(centers)
    best, partner = np.full(n, np.inf), np.full(n, -1)
    for bit in range(int(count - 1).bit_length()):
        side = (component >> bit) & 1 == 1
        for here, there in ((side, ~side), (~side, side)):
            here, there = np.flatnonzero(here), np.flatnonzero(there)
            distance, index = cKDTree(centers[there]).query(centers[here])
            closer = distance < best[here]
            best[here[closer]], partner[here[closer]] = distance[closer], there[index[closer]]
    order = np.lexsort((np.arange(n), best, component))
    first = order[np.r_[True, component[order][1:] != component[order][:-1]]]
    return np.stack([first, partner[first]], axis=1)
