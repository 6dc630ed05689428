"""The view sampler: no state, no test view, and views in the right proportion."""

import numpy as np
import pytest

from graphgs.graph import CameraGraph, ViewSampler

MODES = ("graphgs", "paper", "affine", "uniform")


def _path_graph(n: int = 33, test_every: int = 8) -> CameraGraph:
    """Cameras in a row, each verified with the next two."""
    centers = np.arange(n)[:, None] * [1.0, 0.0, 0.0]
    edges = [(i, i + k) for i in range(n) for k in (1, 2) if i + k < n]
    rotations = np.tile(np.eye(3), (n, 1, 1))
    is_test = np.arange(n) % test_every == 0
    return CameraGraph([str(k) for k in range(n)], rotations, centers, edges, [10] * len(edges), is_test)


@pytest.mark.parametrize("mode", MODES)
def test_a_step_depends_on_seed_and_step_alone(mode):
    graph = _path_graph()
    whole = [ViewSampler(graph, 7, mode).view(step) for step in range(100)]
    resumed = ViewSampler(graph, 7, mode)
    assert [resumed.view(step) for step in reversed(range(100))] == whole[::-1]
    assert [ViewSampler(graph, 8, mode).view(step) for step in range(100)] != whole


@pytest.mark.parametrize("mode", MODES)
def test_views_come_in_proportion_and_never_a_test_view(mode):
    graph = _path_graph()
    sampler = ViewSampler(graph, 0, mode)
    training = np.flatnonzero(~graph.is_test)
    epochs = 300
    counts = np.bincount([sampler.view(s) for s in range(epochs * len(training))], minlength=33)
    assert (counts[graph.is_test] == 0).all()
    p = np.ones(33) if mode == "uniform" else graph.sampling_probability(mode="paper" if mode == "paper" else "graphgs")
    expected = epochs * len(training) * p[training] / p[training].sum()
    # systematic draws are exact to a few; those that skip are independent: 5 standard deviations
    tolerance = 5 * np.sqrt(expected) if mode in ("paper", "affine") else 3.0
    assert (np.abs(counts[training] - expected) <= tolerance).all()


def test_an_epoch_holds_each_view_floor_or_ceil_of_its_share():
    graph = _path_graph()
    sampler = ViewSampler(graph, 3)
    training = np.flatnonzero(~graph.is_test)
    p = graph.sampling_probability()[training]
    share = len(training) * p / p.sum()
    for epoch in range(20):
        drawn = [sampler.view(epoch * len(training) + k) for k in range(len(training))]
        counts = np.bincount(drawn, minlength=33)[training]
        assert (counts >= np.floor(share)).all()
        assert (counts <= np.ceil(share)).all()


def test_uniform_shows_every_view_once_per_epoch():
    graph = _path_graph()
    sampler = ViewSampler(graph, 1, "uniform")
    training = np.flatnonzero(~graph.is_test).tolist()
    orders = [[sampler.view(e * len(training) + k) for k in range(len(training))] for e in range(3)]
    assert all(sorted(order) == training for order in orders)
    assert orders[0] != orders[1]


def test_acceptance_is_the_share_of_iterations_the_paper_executes():
    graph = _path_graph()
    p = graph.sampling_probability(mode="paper")[~graph.is_test]
    assert ViewSampler(graph, 0, "paper").acceptance == pytest.approx(p.mean())
    assert ViewSampler(graph, 0, "uniform").acceptance == 1.0


def test_views_may_be_important_by_degree():
    graph = _path_graph()
    training = np.flatnonzero(~graph.is_test)
    drawn = np.bincount([ViewSampler(graph, 0, measure="degree").view(s) for s in range(50 * len(training))])
    p = graph.sampling_probability(measure="degree")[training]
    assert np.abs(drawn[training] - 50 * len(training) * p / p.sum()).max() <= 3


def test_nothing_to_draw_is_refused():
    graph = _path_graph(test_every=1)
    with pytest.raises(ValueError, match="training view"):
        ViewSampler(graph, 0)
    with pytest.raises(ValueError, match="mode"):
        ViewSampler(_path_graph(), 0, "best")
    with pytest.raises(ValueError, match="step"):
        ViewSampler(_path_graph(), 0).view(-1)


@pytest.mark.parametrize("mode", MODES)
def test_one_training_view(mode):
    graph = CameraGraph("ab", np.tile(np.eye(3), (2, 1, 1)), np.eye(3)[:2], [[0, 1]], [3], [True, False])
    assert {ViewSampler(graph, 0, mode).view(s) for s in range(5)} == {1}
