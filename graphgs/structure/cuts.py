"""The weakest places of a reconstruction: where two groups of its photos share the fewest points."""

import networkx as nx
import numpy as np
from scipy import sparse

from graphgs.scene.covisibility import shared_points
from graphgs.scene.reconstruction import Reconstruction

_MOST = 8  # places looked at
_SMALLEST = 3  # photos of a side, and
_SMALLEST_SHARE = 0.05  # of all
_ALIKE = 0.9  # of the photos on the same side: two cuts are one place


def weakest_cuts(model: Reconstruction) -> list[np.ndarray]:
    """Up to 8 divisions of the photos, each [N] bool, the weakest first: of those that part the strongest spanning tree
    of shared points at one edge, the ones that part the fewest shared points."""
    n = len(model.names)
    shared = sparse.triu(shared_points(model), k=1).tocoo()
    graph = nx.Graph()
    graph.add_nodes_from(range(n))
    graph.add_weighted_edges_from(zip(shared.row.tolist(), shared.col.tolist(), shared.data.tolist(), strict=True))
    tree = nx.maximum_spanning_tree(graph)
    least = max(_SMALLEST, round(_SMALLEST_SHARE * n))
    found = []
    for component in nx.connected_components(tree):
        for side in _sides(tree, next(iter(component)), n):
            if least <= side.sum() <= n - least:
                parted = side[shared.row] != side[shared.col]
                found.append((int(shared.data[parted].sum()), side))
    chosen: list[np.ndarray] = []
    for _, side in sorted(found, key=lambda entry: entry[0]):
        if all(_unlike(side, other) for other in chosen):
            chosen.append(side)
        if len(chosen) == _MOST:
            break
    return chosen


def _sides(tree: nx.Graph, root: int, n: int):
    """For each edge of a tree, [n] bool: what hangs below it."""
    below: dict[int, np.ndarray] = {}
    edges = list(nx.dfs_edges(tree, root))
    for parent, child in reversed(edges):
        own = below.setdefault(child, np.zeros(n, bool))
        own[child] = True
        yield own
        above = below.setdefault(parent, np.zeros(n, bool))
        above |= own


def _unlike(side: np.ndarray, other: np.ndarray) -> bool:
    same = float((side == other).mean())
    return max(same, 1.0 - same) < _ALIKE


def cut_by_scale(ratios: np.ndarray) -> np.ndarray:
    """[N] bool: the photos whose local scale in two reconstructions (ratios [N]) lies above the widest gap."""
    logs = np.log(ratios)
    order = np.sort(logs)
    gap = int(np.diff(order).argmax())
    return logs > (order[gap] + order[gap + 1]) / 2
