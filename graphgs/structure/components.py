"""Which photos hang together: connected components of the verified graph."""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components


def components(
    n: int,
    edges: np.ndarray,  # [E, 2]
) -> list[np.ndarray]:
    """Image indices of each component, the largest first (ties: the one with the first image); single images too."""
    graph = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    groups = [np.flatnonzero(label == k) for k in range(label.max() + 1)] if n else []
    return sorted(groups, key=lambda g: (-len(g), g[0]))


def describe(names: Sequence[str], groups: list[np.ndarray], *, shown: int = 3) -> str:
    """e.g. '31 photos (a.jpg, b.jpg, c.jpg, ...); 4 photos (x.jpg, y.jpg, ...)'; at most five groups."""
    parts = []
    for group in groups[:5]:
        first = ", ".join(names[i] for i in group[:shown]) + (", ..." if len(group) > shown else "")
        parts.append(f"{len(group)} photo{'s' if len(group) > 1 else ''} ({first})")
    if len(groups) > 5:
        parts.append(f"{len(groups) - 5} more groups")
    return "; ".join(parts)
