"""The penalties on opacity and size."""

import pytest
import torch

from graphgs.training.config import TrainConfig
from graphgs.training.regularisation import Regularisation

SCALES = torch.tensor([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]])
OPACITIES = torch.tensor([0.2, 0.6])


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"strategy": "mcmc"}, 0.01 * 0.4 + 0.01 * 0.5),
        ({"strategy": "mcmc", "scale_reg": 0.0}, 0.004),
        ({"opacity_reg": 0.1}, 0.04),
        ({"scale_reg": 0.1}, 0.05),
    ],
)
def test_means_times_their_weights(settings, expected):
    loss = Regularisation(TrainConfig(**settings), extent=2.0).loss(SCALES, OPACITIES)
    assert float(loss) == pytest.approx(expected)


def test_adaptive_control_has_none():
    assert Regularisation(TrainConfig(), extent=2.0).loss(SCALES, OPACITIES) is None
