"""An octree of occupied cells in one sparse field [level, x, y, z], and integer sums over the points of every cell.

Only integers are added and compared, so results depend neither on the order of the points nor on the threads.
No postponed annotations in this file: they break Taichi kernels.
"""

from dataclasses import dataclass
from functools import cache
from threading import Lock

import numpy as np
import taichi as ti

from graphgs.kernels.octree.runtime import ensure_started

DEPTH = 9  # level of the leaves: 512 cells per axis
# Cells per axis of the three SNode layers; small bitmasked blocks, because surfaces fill few cells of a large one.
LAYERS = (16, 8, 4)


@dataclass(frozen=True)
class NodeSums:
    """Per node, over the points inside it."""

    counts: np.ndarray  # [M] int64
    errors: np.ndarray  # [M] int64, fixed point as given
    tracks: np.ndarray  # [M] int64
    lows: np.ndarray  # [M, 3] int64, smallest quantised coordinates
    highs: np.ndarray  # [M, 3] int64


@ti.data_oriented
class SparseOctree:
    """Owns an SNode tree. Use it in a `with`, from one thread at a time: leaving it empties the tree.

    Get it from `sparse_octree`, which makes one per process. Taichi 1.7.4 corrupts its heap after a few dozen trees of
    pointer nodes, destroyed or not (a dozen on two threads), so the tree is emptied and kept. Its cells' memory is
    reused, and so are its compiled kernels.
    """

    def __init__(self):
        self._lock = Lock()
        self.node = ti.field(ti.i32)  # index of a cell's node
        builder = ti.FieldsBuilder()
        self._levels = builder.pointer(ti.ijkl, (DEPTH + 1, *(LAYERS[0],) * 3))
        blocks = self._levels.pointer(ti.ijkl, (1, *(LAYERS[1],) * 3))
        blocks.bitmasked(ti.ijkl, (1, *(LAYERS[2],) * 3)).place(self.node)
        builder.finalize()

    def __enter__(self):
        self._lock.acquire()
        return self

    def __exit__(self, *_):
        self._levels.deactivate_all()
        self._lock.release()

    def insert(
        self,
        cells: np.ndarray,  # [N, 3] int32, leaf cell of every point
    ) -> np.ndarray:
        """Occupy the cells of all levels; the occupied ones, [M, 4] int32 (level, x, y, z), in no particular order."""
        found = np.zeros(1, np.int32)
        self._occupy(cells)
        self._count(found)
        nodes = np.empty((int(found[0]), 4), np.int32)
        found[0] = 0
        self._list(nodes, found)
        return nodes

    def accumulate(
        self,
        nodes: np.ndarray,  # [M, 4] int32, from `insert`, in the order wanted
        cells: np.ndarray,  # [N, 3] int32, as inserted
        coordinates: np.ndarray,  # [N, 3] int64, quantised
        errors: np.ndarray,  # [N] int64, fixed point
        tracks: np.ndarray,  # [N] int64
    ) -> NodeSums:
        """Sums and bounds of the points of each node."""
        count = len(nodes)
        sums = np.zeros((count, 3), np.int64)
        lows = np.full((count, 3), np.iinfo(np.int64).max)
        highs = np.full((count, 3), np.iinfo(np.int64).min)
        self._number(nodes)
        self._add(cells, coordinates, errors, tracks, sums, lows, highs)
        return NodeSums(sums[:, 0], sums[:, 1], sums[:, 2], lows, highs)

    @ti.kernel
    def _occupy(self, cells: ti.types.ndarray(dtype=ti.i32, ndim=2)):
        for p in range(cells.shape[0]):
            for level in range(DEPTH + 1):
                shift = DEPTH - level
                self.node[level, cells[p, 0] >> shift, cells[p, 1] >> shift, cells[p, 2] >> shift] = -1

    @ti.kernel
    def _count(self, found: ti.types.ndarray(dtype=ti.i32, ndim=1)):
        for _level, _x, _y, _z in self.node:
            found[0] += 1

    @ti.kernel
    def _list(
        self,
        nodes: ti.types.ndarray(dtype=ti.i32, ndim=2),
        found: ti.types.ndarray(dtype=ti.i32, ndim=1),
    ):
        for level, x, y, z in self.node:
            n = ti.atomic_add(found[0], 1)
            nodes[n, 0] = level
            nodes[n, 1] = x
            nodes[n, 2] = y
            nodes[n, 3] = z

    @ti.kernel
    def _number(self, nodes: ti.types.ndarray(dtype=ti.i32, ndim=2)):
        for n in range(nodes.shape[0]):
            self.node[nodes[n, 0], nodes[n, 1], nodes[n, 2], nodes[n, 3]] = n

    @ti.kernel
    def _add(
        self,
        # Points
        cells: ti.types.ndarray(dtype=ti.i32, ndim=2),
        coordinates: ti.types.ndarray(dtype=ti.i64, ndim=2),
        errors: ti.types.ndarray(dtype=ti.i64, ndim=1),
        tracks: ti.types.ndarray(dtype=ti.i64, ndim=1),
        # Out
        sums: ti.types.ndarray(dtype=ti.i64, ndim=2),
        lows: ti.types.ndarray(dtype=ti.i64, ndim=2),
        highs: ti.types.ndarray(dtype=ti.i64, ndim=2),
    ):
        for p in range(cells.shape[0]):
            for level in range(DEPTH + 1):
                shift = DEPTH - level
                n = self.node[level, cells[p, 0] >> shift, cells[p, 1] >> shift, cells[p, 2] >> shift]
                ti.atomic_add(sums[n, 0], ti.i64(1))
                ti.atomic_add(sums[n, 1], errors[p])
                ti.atomic_add(sums[n, 2], tracks[p])
                for axis in ti.static(range(3)):
                    ti.atomic_min(lows[n, axis], coordinates[p, axis])
                    ti.atomic_max(highs[n, axis], coordinates[p, axis])


def sparse_octree(*, threads: int) -> SparseOctree:
    """The tree of this process; `threads` counts for the first call that starts Taichi."""
    ensure_started(threads)
    return _only_tree()


@cache
def _only_tree() -> SparseOctree:
    return SparseOctree()
