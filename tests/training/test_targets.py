"""Which view a training view is compared with."""

import numpy as np
import pytest

from graphgs.training.config import TrainConfig
from graphgs.training.consistency import SAMPLED, ConsistencyTerm, target_views
from tests.support.tiny_scene import tiny_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return tiny_scene(tmp_path_factory.mktemp("scene"))


def _drawn(scene, choice: str, seed: int = 0) -> dict[int, list[int]]:
    config = TrainConfig(consistency_target=choice)
    term = ConsistencyTerm(config, scene.views, scene.graph, device="cpu", seed=seed)
    return {int(i): [term.target(i, step) for step in range(200)] for i in np.flatnonzero(~scene.views.is_test)}


def test_the_edge_of_largest_weight(scene):
    targets = scene.graph.targets()
    assert all(set(drawn) == {targets[i]} for i, drawn in _drawn(scene, "max").items())


@pytest.mark.parametrize("choice", ["sampled", "random"])
def test_drawn_ones_are_verified_training_neighbours(scene, choice):
    graph = scene.graph
    for i, drawn in _drawn(scene, choice).items():
        neighbours = {int(b if a == i else a) for a, b in graph.edges if i in (a, b)}
        neighbours = {j for j in neighbours if not graph.is_test[j]}
        best = graph.top_targets(SAMPLED)[i]
        wanted = neighbours if choice == "random" else set(best[best >= 0].tolist())
        assert set(drawn) == wanted


def test_draws_follow_from_the_seed_and_the_step(scene):
    assert _drawn(scene, "random") == _drawn(scene, "random")
    assert _drawn(scene, "random") != _drawn(scene, "random", seed=1)


def test_views_the_graph_does_not_know_have_no_target(scene):
    few = target_views(scene.views, scene.graph, mode="graphgs")
    assert set(few) <= set(np.flatnonzero(~scene.views.is_test).tolist())
