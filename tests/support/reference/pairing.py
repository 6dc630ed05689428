"""Concentric pairing by the definition, one pair at a time."""

import networkx as nx
import numpy as np


def concentric_pairs(centers: np.ndarray, r: int, h: int, w: int, connect: str | None) -> dict[tuple[int, int], int]:
    """{(i, j): kinds} with kinds 1 neighbour, 2 ring, 4 connection."""
    n = len(centers)
    kinds: dict[tuple[int, int], int] = {}

    def take(i: int, j: int, kind: int) -> None:
        pair = (min(i, j), max(i, j))
        kinds[pair] = kinds.get(pair, 0) | kind

    for i in range(n):
        others = [j for j in range(n) if j != i]
        others.sort(key=lambda j: (np.sqrt(((centers[i] - centers[j]) ** 2).sum()), j))
        for s, j in enumerate(others, start=1):
            if s <= r:
                take(i, j, 1)
            elif 0 <= (s - r) % (h + w) < w:
                take(i, j, 2)
        if connect == "sequence" and i > 0:
            take(i, i - 1, 4)
    return kinds


def tree_cost(centers: np.ndarray, directions: np.ndarray, spacing: float) -> float:
    """Total cost of the minimum spanning tree on distance in spacings plus 1 - cos of the viewing angle."""
    graph = nx.Graph()
    for i in range(len(centers)):
        for j in range(i):
            graph.add_edge(i, j, weight=link_cost(centers, directions, spacing, i, j))
    return sum(d["weight"] for _, _, d in nx.minimum_spanning_tree(graph).edges(data=True))


def link_cost(centers: np.ndarray, directions: np.ndarray, spacing: float, i: int, j: int) -> float:
    return float(np.linalg.norm(centers[i] - centers[j]) / spacing + 1.0 - directions[i] @ directions[j])


def is_connected(pairs: np.ndarray, n: int) -> bool:
    graph = nx.Graph()
    graph.add_nodes_from(range(n))
    graph.add_edges_from(pairs.tolist())
    return n == 0 or nx.is_connected(graph)
