"""Edge weights, targets and sampling probabilities by the formulas, one camera at a time."""

import math

import networkx as nx
import numpy as np


def weight(graph, e: int, mode: str, k: float = 1.0) -> float:
    if graph.inliers[e] == 0:
        return 0.0
    i, j = graph.edges[e]
    distance = float(np.linalg.norm(graph.centers[i] - graph.centers[j]))
    dot = float(graph.rotations[i, 2] @ graph.rotations[j, 2])
    if mode == "paper":
        below = 1.0 - math.exp(-dot)
        return math.exp(-k * distance) / below if below else math.inf
    spacing = (_spacing(graph, i) + _spacing(graph, j)) / 2
    theta = math.acos(max(-1.0, min(1.0, dot)))
    return math.exp(-distance / (k * spacing)) / (1.0 - math.exp(-max(theta, math.radians(5.0))))


def _spacing(graph, i: int) -> float:
    distances = np.sort(np.linalg.norm(graph.centers - graph.centers[i], axis=1))
    apart = distances[distances > 1e-9]
    return float(np.median(apart[:5])) if len(apart) else 1.0


def targets(graph, mode: str) -> list[int]:
    result = []
    for i in range(len(graph.names)):
        best, best_weight = -1, -math.inf
        for e, (a, b) in enumerate(graph.edges):
            if i not in (a, b) or graph.inliers[e] == 0 or graph.is_test[a] or graph.is_test[b]:
                continue
            w = weight(graph, e, mode)
            if w > best_weight * (1 + 1e-9 * np.sign(best_weight)) or best == -1:
                best, best_weight = int(b if i == a else a), w
        result.append(best)
    return result


def importance(graph) -> np.ndarray:
    training = nx.Graph()
    training.add_nodes_from(i for i in range(len(graph.names)) if not graph.is_test[i])
    training.add_edges_from(
        (int(i), int(j))
        for (i, j), count in zip(graph.edges, graph.inliers, strict=True)
        if count > 0 and not graph.is_test[i] and not graph.is_test[j]
    )
    values = nx.betweenness_centrality(training, normalized=True, endpoints=False)
    return np.array([values.get(i, 0.0) for i in range(len(graph.names))])


def degree(graph) -> np.ndarray:
    """[N] networkx's degree centrality of the verified graph of training views, 0 for test views."""
    training = nx.Graph()
    training.add_nodes_from(np.flatnonzero(~graph.is_test).tolist())
    for (i, j), inliers in zip(graph.edges.tolist(), graph.inliers, strict=True):
        if inliers > 0 and not graph.is_test[i] and not graph.is_test[j]:
            training.add_edge(i, j)
    values = np.zeros(len(graph.names))
    for node, value in nx.degree_centrality(training).items():
        values[node] = value
    return values
