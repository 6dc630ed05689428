"""The sparse tree against plain counting."""

import numpy as np
import pytest

from graphgs.kernels.octree import DEPTH, sparse_octree


def _points(count: int, seed: int):
    rng = np.random.default_rng(seed)
    cells = rng.integers(0, 40, (count, 3)).astype(np.int32) * 12
    return cells, rng.integers(0, 2**28, (count, 3)), rng.integers(0, 5000, count), rng.integers(1, 20, count)


def _expected_cells(cells: np.ndarray) -> np.ndarray:
    rows = [np.column_stack([np.full(len(cells), k), cells >> (DEPTH - k)]) for k in range(DEPTH + 1)]
    return np.unique(np.concatenate(rows), axis=0)


def test_occupied_cells_and_their_sums():
    cells, coordinates, errors, tracks = _points(500, 0)
    with sparse_octree(threads=2) as tree:
        nodes = tree.insert(cells)
        nodes = nodes[np.lexsort(nodes.T[::-1])]
        sums = tree.accumulate(nodes, cells, coordinates, errors, tracks)
    np.testing.assert_array_equal(nodes, _expected_cells(cells))
    assert sums.counts[0] == 500
    for n in np.random.default_rng(1).choice(len(nodes), 60, replace=False):
        level, *cell = nodes[n]
        inside = ((cells >> (DEPTH - level)) == cell).all(1)
        assert sums.counts[n] == inside.sum()
        assert sums.errors[n] == errors[inside].sum()
        assert sums.tracks[n] == tracks[inside].sum()
        np.testing.assert_array_equal(sums.lows[n], coordinates[inside].min(0))
        np.testing.assert_array_equal(sums.highs[n], coordinates[inside].max(0))


def test_a_tree_is_empty_again_after_use_also_after_an_error():
    for seed in range(50):  # dozens of uses: new trees each time would crash Taichi
        cells = _points(30 + seed, seed)[0]
        with sparse_octree(threads=2) as tree:
            assert len(tree.insert(cells)) == len(_expected_cells(cells))
        with pytest.raises(IndexError), sparse_octree(threads=2) as tree:
            tree.insert(cells)[len(cells) * 10 + 10]


def test_sums_beyond_32_bits():
    cells = np.zeros((1000, 3), np.int32)
    with sparse_octree(threads=2) as tree:
        nodes = tree.insert(cells)
        large = np.full(1000, 2**40)
        sums = tree.accumulate(nodes, cells, np.zeros((1000, 3), np.int64), large, large)
    assert len(nodes) == DEPTH + 1
    assert (sums.errors == 1000 * 2**40).all()
