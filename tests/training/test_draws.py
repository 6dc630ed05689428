"""Random rows of a step."""

import torch

from graphgs.training.draws import draw_rows, generator_of


def test_rows_come_in_proportion_and_never_without_weight():
    weights = torch.tensor([0.0, 3.0, 0.0, 1.0, 0.0])
    rows = draw_rows(weights, 4000, generator_of(0, 0))
    counts = torch.bincount(rows, minlength=5)
    assert counts[[0, 2, 4]].tolist() == [0, 0, 0]
    assert abs(int(counts[1]) - 3000) < 6 * 28  # six standard deviations


def test_seed_and_step_decide():
    draws = [
        torch.rand(3, generator=generator_of(seed, step)).tolist() for seed, step in ((0, 1), (0, 1), (0, 2), (1, 1))
    ]
    assert draws[0] == draws[1]
    assert len({tuple(draw) for draw in draws}) == 3
