"""Ranges of indices on several threads."""

import numpy as np
import pytest
import warp as wp

from graphgs.kernels.launch import launch_range


@wp.kernel(enable_backward=False)
def count_visits(first: int, step: int, visits: wp.array[int]):
    i = first + wp.tid()
    visits[i] = visits[i] + step + i


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 7, 1000])
def test_each_index_is_visited_once(count, threads):
    visits = wp.zeros(1000, dtype=int, device="cpu")
    launch_range(count_visits, count, inputs=[3], outputs=[visits], device="cpu", threads=threads)
    expected = np.where(np.arange(1000) < count, np.arange(1000) + 3, 0)
    assert np.array_equal(visits.numpy(), expected)


def test_small_work_is_not_split_below_the_smallest_chunk():
    visits = wp.zeros(10, dtype=int, device="cpu")
    launch_range(count_visits, 10, inputs=[1], outputs=[visits], device="cpu", threads=2, min_chunk=4)
    assert np.array_equal(visits.numpy(), np.arange(10) + 1)
