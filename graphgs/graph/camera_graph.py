"""The camera graph: posed photos as nodes, verified pairs as edges, and what training reads off it."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from graphgs.graph.edge_weight import WeightMode, best_partners, edge_weights
from graphgs.graph.importance import betweenness, degree

Measure = Literal["betweenness", "degree"]


@dataclass(frozen=True)
class CameraGraph:
    """Refined poses, the pairs that survived verification, and which views are held out.

    Held-out views are nodes like any other in the file, but no path, target or draw ever uses one."""

    names: tuple[str, ...]  # [N] photos, sorted
    rotations: np.ndarray  # [N, 3, 3] camera-from-world
    centers: np.ndarray  # [N, 3] world
    edges: np.ndarray  # [E, 2] int, each pair once
    inliers: np.ndarray  # [E] verified matches; 0 = no verified point in common
    is_test: np.ndarray  # [N] bool
    kinds: np.ndarray | None = None  # [E] uint8 bits, why the pair was a candidate (as in Pairs); None = not known

    def __post_init__(self):
        def take(name: str, dtype, *shape: int | None) -> None:
            array = np.asarray(getattr(self, name), dtype)
            if array.size == 0 and 0 in shape:
                array = array.reshape(shape)
            if array.shape != shape:
                raise ValueError(f"{name}: expected {list(shape)}, got {list(array.shape)}")
            object.__setattr__(self, name, array)

        object.__setattr__(self, "names", tuple(self.names))
        n, e = len(self.names), len(self.edges)
        if len(set(self.names)) != n:
            raise ValueError("names: expected each photo once")
        take("rotations", np.float64, n, 3, 3)
        take("centers", np.float64, n, 3)
        take("edges", np.int64, e, 2)
        take("inliers", np.int64, e)
        take("is_test", bool, n)
        if self.kinds is not None:
            take("kinds", np.uint8, e)
        if not (np.isfinite(self.rotations).all() and np.isfinite(self.centers).all()):
            raise ValueError("rotations, centers: expected finite numbers")
        low, high = np.sort(self.edges, axis=1).T
        if e and not (self.edges.min() >= 0 and self.edges.max() < n and (low < high).all()):
            raise ValueError(f"edges: expected two different cameras in 0..{n - 1}")
        if len(np.unique(low * n + high)) < e:
            raise ValueError("edges: expected each pair once")

    def edge_weights(self, mode: WeightMode = "graphgs", *, k: float = 1.0) -> np.ndarray:
        """[E] see `graphgs.graph.edge_weight`: 0..12 in the `graphgs` form; as printed, so also negative or infinite,
        in the `paper` form. 0 without inliers."""
        return edge_weights(self.rotations, self.centers, self.edges, self.inliers, mode=mode, k=k)

    def targets(self, mode: WeightMode = "graphgs") -> np.ndarray:
        """[N] int: for each training view the training view to be consistent with, the other end of its verified edge
        of largest weight; -1 for none, and for test views, which enter no photometric term on either side."""
        return self.top_targets(1, mode)[:, 0]

    def top_targets(self, count: int, mode: WeightMode = "graphgs") -> np.ndarray:
        """[N, count] int: the best few targets, best first, filled with -1: for drawing among them."""
        usable = self._among_training & (self.inliers > 0)
        return best_partners(self.edges, self.edge_weights(mode), usable, len(self.names), count)

    def importance(self, measure: Measure = "betweenness") -> np.ndarray:
        """[N] unweighted betweenness on the verified graph of training views, or their degree there, normalised as
        networkx does; 0 for test views."""
        if measure not in ("betweenness", "degree"):
            raise ValueError(f"measure: expected 'betweenness' or 'degree', got {measure!r}")
        return (self._betweenness if measure == "betweenness" else self._degree).copy()

    def sampling_probability(
        self, minimum: float = 0.5, *, mode: WeightMode = "graphgs", measure: Measure = "betweenness"
    ) -> np.ndarray:
        """[N] how often a view is worth a step, in minimum..1, 0 for test views. With w the importance:
        `graphgs`: minimum + (1 - minimum) w / max w, which still ranks the views below `minimum`;
        `paper`: max(minimum, w / max w). 1 for all where max w is 0 (every view sees every other)."""
        if mode not in ("graphgs", "paper"):
            raise ValueError(f"mode: expected 'graphgs' or 'paper', got {mode!r}")
        if not 0.0 <= minimum <= 1.0:
            raise ValueError(f"minimum: expected 0..1, got {minimum}")
        importance = self.importance(measure)
        largest = importance.max(initial=0.0)
        share = importance / largest if largest > 0 else np.ones(len(self.names))
        probability = np.maximum(minimum, share) if mode == "paper" else minimum + (1.0 - minimum) * share
        return np.where(self.is_test, 0.0, probability)

    def save(self, path: Path) -> None:
        """Write graph.json (node-link form); a folder gets it under that name."""
        from graphgs.graph.graph_file import write_graph

        write_graph(self, Path(path))

    @staticmethod
    def load(path: Path) -> "CameraGraph":
        """Read what `save` wrote, bit for bit. Raises DataError where the file is damaged."""
        from graphgs.graph.graph_file import read_graph

        return read_graph(Path(path))

    @cached_property
    def _among_training(self) -> np.ndarray:
        return ~self.is_test[self.edges].any(1)

    @cached_property
    def _betweenness(self) -> np.ndarray:
        return self._of_training_views(betweenness)

    @cached_property
    def _degree(self) -> np.ndarray:
        return self._of_training_views(degree)

    def _of_training_views(self, measure) -> np.ndarray:
        """[N] of `measure(edges, n)` on the verified graph of training views, 0 elsewhere."""
        training = np.flatnonzero(~self.is_test)
        index = np.cumsum(~self.is_test) - 1
        used = self._among_training & (self.inliers > 0)
        values = np.zeros(len(self.names))
        values[training] = measure(index[self.edges[used]], len(training))
        return values
