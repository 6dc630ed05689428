"""Trainable rows and their Adam moments."""

import torch

from graphgs.rendering.splats import TENSORS, Splats
from graphgs.training.parameters import EPS, Parameters

RATES = {"means": 1e-2, "quats": 2e-2, "log_scales": 3e-2, "logit_opacities": 4e-2, "sh_dc": 5e-2, "sh_rest": 6e-3}
SH_RATES = torch.tensor([RATES["sh_dc"]] + 15 * [RATES["sh_rest"]])[:, None]  # by harmonic


def _splats(count: int = 5) -> Splats:
    generator = torch.Generator().manual_seed(1)
    shapes = {"means": (3,), "quats": (4,), "log_scales": (3,), "logit_opacities": (), "sh_coeffs": (16, 3)}
    return Splats(**{name: torch.randn((count, *shapes[name]), generator=generator) for name in TENSORS})


def _descend(parameters: Parameters, first: int, steps: int) -> None:
    for step in range(first, first + steps):
        sum((value**4).sum() for value in parameters.values.values()).backward()
        parameters.step(step, RATES)


def test_splats_come_back_unchanged():
    splats = _splats()
    back = Parameters.from_splats(splats).splats(3)
    assert all(torch.equal(getattr(back, name), getattr(splats, name)) for name in TENSORS)


def test_update_is_adam():
    parameters = Parameters.from_splats(_splats())
    twin = {name: value.detach().double() for name, value in parameters.values.items()}
    _descend(parameters, 0, 5)
    for name, value in twin.items():  # Kingma & Ba 2015, algorithm 1
        m, v = torch.zeros_like(value), torch.zeros_like(value)
        for t in range(1, 6):
            gradient = 4 * value**3
            m = 0.9 * m + 0.1 * gradient
            v = 0.999 * v + 0.001 * gradient**2
            rate = SH_RATES if name == "sh_coeffs" else RATES[name]
            value = value - rate * (m / (1 - 0.9**t)) / ((v / (1 - 0.999**t)).sqrt() + EPS)
        torch.testing.assert_close(parameters.values[name].detach().double(), value, rtol=1e-5, atol=1e-6)


def test_a_group_without_gradient_stays():
    parameters = Parameters.from_splats(_splats())
    before = parameters.values["sh_coeffs"].detach().clone()
    parameters.values["means"].sum().backward()
    parameters.step(0, RATES)
    assert torch.equal(parameters.values["sh_coeffs"], before)
    assert parameters.values["means"].grad is None


def test_rebuild_keeps_rows_with_their_moments():
    parameters = Parameters.from_splats(_splats())
    _descend(parameters, 0, 2)
    before = {name: tensor.clone() for name, tensor in parameters.state().items()}
    added = {name: torch.ones_like(value.detach()[:2]) for name, value in parameters.values.items()}
    parameters.rebuild(torch.tensor([3, 0]), added)
    assert len(parameters) == 4
    for name, tensor in parameters.state().items():
        assert torch.equal(tensor[:2], before[name][[3, 0]])
        assert (tensor[2:] == (1.0 if name.startswith("values.") else 0.0)).all()
    _descend(parameters, 2, 1)  # still trainable


def test_overwritten_rows_forget_their_moments():
    parameters = Parameters.from_splats(_splats())
    _descend(parameters, 0, 2)
    before = {name: tensor.clone() for name, tensor in parameters.state().items()}
    parameters.overwrite(
        torch.tensor([3, 0]), {name: torch.ones_like(value.detach()[:2]) for name, value in parameters.values.items()}
    )
    for name, tensor in parameters.state().items():
        assert torch.equal(tensor[[1, 2, 4]], before[name][[1, 2, 4]])
        assert (tensor[[0, 3]] == (1.0 if name.startswith("values.") else 0.0)).all()
    _descend(parameters, 2, 1)  # still trainable


def test_state_restores_every_bit():
    parameters = Parameters.from_splats(_splats())
    _descend(parameters, 0, 2)
    twin = Parameters.from_state({name: tensor.clone() for name, tensor in parameters.state().items()}, "cpu")
    _descend(parameters, 2, 3)
    _descend(twin, 2, 3)
    assert all(torch.equal(twin.state()[name], tensor) for name, tensor in parameters.state().items())


def test_values_that_are_not_finite_are_seen():
    parameters = Parameters.from_splats(_splats())
    assert parameters.is_finite
    with torch.no_grad():
        parameters.values["sh_coeffs"][2, 3, 1] = float("inf")
    assert not parameters.is_finite


def test_sparse_adam_moves_the_rows_it_is_given_as_dense_adam_does_and_no_other():
    dense, sparse = (Parameters.from_splats(_splats()) for _ in range(2))
    rows = torch.tensor([1, 3])
    for step in range(3):
        for parameters in (dense, sparse):
            generator = torch.Generator().manual_seed(step)
            for value in parameters.values.values():
                value.grad = torch.randn(value.shape, generator=generator)
        dense.step(step, RATES)
        sparse.step(step, RATES, rows=rows)
    before, others = Parameters.from_splats(_splats()), torch.tensor([0, 2, 4])
    for name, value in sparse.values.items():
        torch.testing.assert_close(
            value[rows], dense.values[name][rows], rtol=1e-5, atol=1e-7
        )  # vectors round otherwise
        assert torch.equal(value[others], before.values[name][others])
        assert not sparse.moments1[name][others].any()
        torch.testing.assert_close(sparse.moments2[name][rows], dense.moments2[name][rows])
