"""3DGS as MCMC: what relocation preserves, who moves, and the limit that holds."""

import numpy as np
import pytest
import torch

from graphgs.rendering.splats import Splats
from graphgs.training.config import TrainConfig
from graphgs.training.mcmc import MOST_SHARES, MarkovChain, share
from graphgs.training.parameters import GROUPS, Parameters
from graphgs.training.schedule import Schedule

ROUND = 9_999  # a round follows this step
BETWEEN = 10_010  # none follows this one


def _setting(opacities, *, max_splats=100, seed=0, extent=1.0, noise=0.0):
    """Gaussians of size 0.1 at x = 0, 10, 20, ... with the given opacities."""
    count = len(opacities)
    config = TrainConfig(steps=30_000, strategy="mcmc", max_splats=max_splats, mcmc_growth=0.5, mcmc_noise=noise)
    splats = Splats(
        means=torch.stack([10.0 * torch.arange(count), torch.zeros(count), torch.zeros(count)], 1),
        quats=torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
        log_scales=torch.full((count, 3), float(np.log(0.1))),
        logit_opacities=torch.logit(torch.tensor(opacities)),
        sh_coeffs=torch.zeros(count, 16, 3),
    )
    strategy = MarkovChain(config, Schedule(config), extent=extent, seed=seed, count=count, device="cpu")
    return strategy, Parameters.from_splats(splats)


@pytest.mark.parametrize("count", [1, 2, 3, 10, MOST_SHARES])
@pytest.mark.parametrize("opacity", [0.01, 0.5, 0.99])
def test_shares_look_like_the_whole(count, opacity):
    """Equal peak, and equal sum along a line through the centre: what the authors solve for."""
    new, shrink = share(torch.tensor([opacity], dtype=torch.float64), torch.tensor([count]))
    new, shrink = float(new), float(shrink)
    assert 1 - (1 - new) ** count == pytest.approx(opacity, rel=1e-9)
    x = np.linspace(-12.0, 12.0, 4801)
    whole = opacity * np.exp(-(x**2) / 2)
    shares = 1 - (1 - new * np.exp(-(x**2) / (2 * shrink**2))) ** count
    assert shares.sum() == pytest.approx(whole.sum(), rel=1e-6)  # the terms alternate, up to 200 times the sum


def test_no_more_shares_than_the_limit():
    few, many = share(torch.tensor([0.5, 0.5]), torch.tensor([MOST_SHARES, 1000]))[0]
    assert few == many


def test_the_dead_move_to_the_living():
    strategy, parameters = _setting([0.8, 0.001, 0.001], max_splats=3)
    for name in GROUPS:
        parameters.moments1[name] += 1.0
    strategy.after_step(ROUND, parameters)
    assert parameters.values["means"].detach()[:, 0].tolist() == [0.0, 0.0, 0.0]
    opacities = torch.sigmoid(parameters.values["logit_opacities"].detach())
    torch.testing.assert_close(opacities, torch.full((3,), 1 - 0.2 ** (1 / 3)), rtol=1e-5, atol=0)
    assert (parameters.values["log_scales"].detach() < np.log(0.1)).all()
    assert not any(parameters.moments1[name].any() for name in GROUPS)


def test_the_opaque_attract_more():
    strategy, parameters = _setting([0.9, 0.09] + [0.001] * 200, max_splats=202)
    strategy.after_step(ROUND, parameters)
    x = parameters.values["means"].detach()[:, 0]
    assert 170 < int((x == 0).sum()) < 195  # 1 + 200 * 10 / 11, six standard deviations each way


@pytest.mark.parametrize(("limit", "expected"), [(4, 4), (5, 5), (100, 6)])
def test_growth_ends_at_the_limit(limit, expected):
    strategy, parameters = _setting([0.5] * 4, max_splats=limit)
    strategy.after_step(ROUND, parameters)
    assert len(parameters) == expected  # half more at most
    assert parameters.moments1["means"].shape[0] == expected


def test_nobody_moves_between_rounds_or_after_the_window():
    for step in (BETWEEN, 25_999):
        strategy, parameters = _setting([0.8, 0.001])
        strategy.after_step(step, parameters)
        assert parameters.values["means"].detach()[:, 0].tolist() == [0.0, 10.0]


def test_a_scene_of_the_dead_stays():
    strategy, parameters = _setting([0.001, 0.001], max_splats=2)
    strategy.after_step(ROUND, parameters)
    assert parameters.values["means"].detach()[:, 0].tolist() == [0.0, 10.0]


def test_noise_disturbs_the_faint_along_their_covariance():
    strategy, parameters = _setting([0.001] * 400 + [0.5], noise=5e5)
    with torch.no_grad():
        parameters.values["log_scales"][:, 1] = -30.0
    before = parameters.values["means"].detach().clone()
    strategy.after_step(BETWEEN, parameters)
    moved = parameters.values["means"].detach() - before
    assert moved[:-1, 0].std() > 1e-3
    assert moved[:, 1].abs().max() < 1e-12  # no extent, no noise
    assert moved[-1].abs().max() < 1e-12  # opaque


def test_noise_does_not_depend_on_the_scale_of_the_scene():
    moves = []
    for scale in (1.0, 1000.0):
        strategy, parameters = _setting([0.001] * 3, extent=scale, noise=5e5)
        with torch.no_grad():
            parameters.values["means"] *= scale
            parameters.values["log_scales"] += float(np.log(scale))
        before = parameters.values["means"].detach().clone()
        strategy.after_step(BETWEEN, parameters)
        moves.append((parameters.values["means"].detach() - before) / scale)
    # the sum mean + noise is rounded at 2e-6 (float32 at 20)
    torch.testing.assert_close(moves[0], moves[1], rtol=1e-3, atol=4e-6)


def test_draws_depend_on_the_seed_and_the_step_alone():
    def means(seed):
        strategy, parameters = _setting([0.5] * 6 + [0.001] * 6, max_splats=12, seed=seed, noise=5e5)
        strategy.after_step(ROUND, parameters)
        return parameters.values["means"].detach()

    assert torch.equal(means(1), means(1))
    assert not torch.equal(means(1), means(2))
