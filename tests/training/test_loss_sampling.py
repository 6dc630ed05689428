"""Views drawn by their losses: proportions, and a state that resumes."""

import numpy as np
import pytest
import torch

from graphgs.graph import CameraGraph
from graphgs.training.loss_sampling import LossSampler

N, EPOCHS = 17, 80
IS_TEST = np.arange(N) % 8 == 0
TRAINING = np.flatnonzero(~IS_TEST)
LOSSES = np.where(TRAINING % 2 == 0, 0.4, 0.1)


def _graph() -> CameraGraph:
    names = tuple(map(str, range(N)))
    return CameraGraph(names, np.tile(np.eye(3), (N, 1, 1)), np.eye(N, 3), np.zeros((0, 2), int), [], IS_TEST)


def _drawn(sampler: LossSampler, first: int, last: int) -> list[int]:
    nodes = []
    for step in range(first, last):
        node = sampler.view(step)
        sampler.view(step + 1)  # as the decoder asks, a step ahead
        loss = LOSSES[np.searchsorted(TRAINING, node)]
        sampler.note(node, step, torch.tensor(loss, dtype=torch.float32))
        nodes.append(node)
    return nodes


def test_views_come_in_proportion_to_their_losses():
    v = len(TRAINING)
    drawn = _drawn(LossSampler(_graph(), seed=0, device="cpu"), 0, EPOCHS * v)
    assert not set(drawn) & set(np.flatnonzero(IS_TEST))
    counts = np.bincount(drawn[2 * v :], minlength=N)[TRAINING]
    p = 0.5 + 0.5 * LOSSES / LOSSES.max()
    assert np.abs(counts - (EPOCHS - 2) * v * p / p.sum()).max() <= 3
    assert sorted(drawn[:v]) == sorted(drawn[v : 2 * v]) == TRAINING.tolist()  # nothing is known yet


@pytest.mark.parametrize("stop", [3, len(TRAINING), 4 * len(TRAINING) - 1])
def test_a_resumed_run_draws_the_same(stop):
    end = 7 * len(TRAINING)
    whole = _drawn(LossSampler(_graph(), seed=5, device="cpu"), 0, end)
    first = LossSampler(_graph(), seed=5, device="cpu")
    drawn = _drawn(first, 0, stop)
    second = LossSampler(_graph(), seed=5, device="cpu")
    second.load_state({name: tensor.clone() for name, tensor in first.state().items()})
    if stop:
        assert second.view(stop - 1) == drawn[-1]  # a roll-back names the view it stopped at
    assert drawn + _drawn(second, stop, end) == whole


def test_without_training_views_there_is_nothing_to_draw():
    graph = CameraGraph("a", np.eye(3)[None], np.zeros((1, 3)), np.zeros((0, 2), int), [], [True])
    with pytest.raises(ValueError, match="training view"):
        LossSampler(graph, seed=0, device="cpu")
