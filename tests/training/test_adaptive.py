"""Adaptive control: who is cloned, split and removed, and the limit that holds."""

import itertools
from types import SimpleNamespace

import pytest
import torch

from graphgs.rendering.splats import Splats
from graphgs.training.adaptive import AdaptiveControl
from graphgs.training.config import TrainConfig
from graphgs.training.parameters import Parameters
from graphgs.training.schedule import Schedule

ROUND = 14_899  # the last round follows this step: the whole budget is open
EXTENT = 2.0
SMALL, LARGE = 0.001, 0.05  # standard deviations in extents; the border is 0.01


def _setting(sizes, opacities, *, max_splats=100, seed=0, **options):
    """Gaussians far apart on x, of given sizes (in extents) and opacities; 3DGS's rules unless others are named."""
    count = len(sizes)
    options = {"absgrad": False, "revised_opacity": False} | options
    config = TrainConfig(steps=30_000, max_splats=max_splats, **options)
    splats = Splats(
        means=torch.stack([10.0 * torch.arange(count), torch.zeros(count), torch.zeros(count)], 1),
        quats=torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
        log_scales=torch.log(EXTENT * torch.tensor(sizes))[:, None].repeat(1, 3),
        logit_opacities=torch.logit(torch.tensor(opacities)),
        sh_coeffs=torch.zeros(count, 16, 3),
    )
    strategy = AdaptiveControl(config, Schedule(config), extent=EXTENT, seed=seed, count=count, device="cpu")
    return strategy, Parameters.from_splats(splats)


def _see(strategy, pulls, *, width=64, height=32):
    """One view in which Gaussian g has the NDC gradient norm pulls[g]; None = not visible."""
    seen = torch.tensor([pull is not None for pull in pulls])
    gradient = torch.zeros(1, len(pulls), 2)
    gradient[0, :, 1] = torch.tensor([pull or 0.0 for pull in pulls]) / (height / 2)
    strategy.after_backward(
        0,
        SimpleNamespace(
            colors=torch.zeros(1, height, width, 3),
            means2d=SimpleNamespace(grad=gradient, absgrad=4 * gradient),
            radii=(5 * seen[None, :, None].int()).repeat(1, 1, 2),
        ),
    )


def test_small_is_cloned_large_is_split_faint_is_removed():
    strategy, parameters = _setting([SMALL, LARGE, SMALL, SMALL], [0.5, 0.5, 0.5, 0.001])
    _see(strategy, [3e-4, 3e-4, 1e-4, 3e-4])
    strategy.after_step(ROUND, parameters)
    x = parameters.values["means"].detach()[:, 0]
    sizes = parameters.values["log_scales"].detach().exp()[:, 0] / EXTENT
    assert [int((x - 10 * g).abs().lt(4).sum()) for g in range(4)] == [2, 2, 1, 0]
    halves = (x - 10).abs() < 4
    torch.testing.assert_close(sizes[halves], torch.full((2,), LARGE / 1.6))
    assert x[halves].unique().numel() == 2
    assert (sizes[~halves] - SMALL).abs().max() < 1e-6


def test_pull_is_the_mean_over_views_that_saw_it():
    strategy, parameters = _setting([SMALL, SMALL], [0.5, 0.5])
    _see(strategy, [5e-4, 5e-4])
    for _ in range(2):
        _see(strategy, [0.0, None])  # 5e-4 / 3 < threshold for the first, 5e-4 / 1 for the second
    strategy.after_step(ROUND, parameters)
    assert sorted(parameters.values["means"][:, 0].tolist()) == [0.0, 10.0, 10.0]


def test_statistics_start_afresh_after_a_round():
    strategy, parameters = _setting([SMALL], [0.5])
    _see(strategy, [1e-3])
    strategy.after_step(ROUND - 100, parameters)
    strategy.after_step(ROUND, parameters)
    assert len(parameters) == 2
    assert strategy.state()["pull"].shape == (2,)


@pytest.mark.parametrize("limit", [6, 7, 8, 20])
def test_the_limit_holds_and_the_strongest_go_first(limit):
    strategy, parameters = _setting([SMALL, LARGE] * 3, [0.5] * 6, max_splats=limit)
    pulls = [3e-4, 8e-4, 5e-4, 6e-4, 7e-4, 4e-4]
    _see(strategy, pulls)
    strategy.after_step(ROUND, parameters)
    assert len(parameters) == min(limit, 12)
    x = parameters.values["means"].detach()[:, 0]
    grown = [g for g in range(6) if int((x - 10 * g).abs().lt(4).sum()) == 2]
    strongest = sorted(range(6), key=lambda g: -pulls[g])[: limit - 6]
    assert grown == sorted(strongest)


def test_the_budget_opens_round_by_round():
    strategy, _ = _setting([SMALL] * 4, [0.5] * 4, max_splats=1004)
    limits = [strategy.limit_after(step) for step in range(499, 14_900, 100)]
    growth = [later - earlier for earlier, later in itertools.pairwise([4, *limits])]
    assert limits[-1] == 1004
    assert 12 <= growth[0] <= 15  # twice an even share: 1000 / 145
    assert all(later <= earlier + 1 for earlier, later in itertools.pairwise(growth))


def test_no_early_round_takes_the_whole_budget():
    strategy, parameters = _setting([SMALL] * 10, [0.5] * 10, max_splats=20)
    _see(strategy, [1e-3] * 10)
    strategy.after_step(2999, parameters)
    assert len(parameters) == strategy.limit_after(2999) == 13


def test_no_scene_is_emptied():
    strategy, parameters = _setting([SMALL, SMALL], [0.001, 0.001])
    _see(strategy, [0.0, 0.0])
    strategy.after_step(ROUND, parameters)
    assert len(parameters) == 2


def test_oversized_ones_go_only_after_the_first_reset():
    for step, left in ((999, 2), (3999, 1)):
        strategy, parameters = _setting([SMALL, 0.3], [0.5, 0.5])
        _see(strategy, [0.0, 0.0])
        strategy.after_step(step, parameters)
        assert len(parameters) == left


def test_reset_caps_opacities_and_forgets_their_moments():
    strategy, parameters = _setting([SMALL, SMALL], [0.5, 0.007])
    parameters.moments1["logit_opacities"] += 1.0
    _see(strategy, [0.0, 0.0])
    strategy.after_step(2999, parameters)
    torch.testing.assert_close(
        torch.sigmoid(parameters.values["logit_opacities"].detach()), torch.tensor([0.01, 0.007]), rtol=1e-4, atol=0
    )
    assert not parameters.moments1["logit_opacities"].any()


def test_splits_depend_on_the_seed_and_the_step_alone():
    def means(seed):
        strategy, parameters = _setting([LARGE], [0.5], seed=seed)
        _see(strategy, [1e-3])
        strategy.after_step(ROUND, parameters)
        return parameters.values["means"].detach()

    assert torch.equal(means(1), means(1))
    assert not torch.equal(means(1), means(2))


@pytest.mark.parametrize(("absgrad", "grown"), [(False, [0, 1]), (True, [0])])
def test_absolute_gradients_have_a_threshold_of_their_own(absgrad, grown):
    strategy, parameters = _setting([SMALL] * 3, [0.5] * 3, absgrad=absgrad, densify_absgrad=1.1e-3)
    assert strategy.wants_absgrad(0) is absgrad
    assert not strategy.wants_absgrad(20_000)
    _see(strategy, [3e-4, 2.5e-4, 1e-4])  # and four times as much in absolute value
    strategy.after_step(ROUND, parameters)
    x = parameters.values["means"].detach()[:, 0]
    assert [g for g in range(3) if int((x == 10 * g).sum()) == 2] == grown


def test_revised_opacity_lets_the_same_light_through():
    strategy, parameters = _setting([SMALL, LARGE, SMALL, SMALL], [0.5, 0.96, 0.5, 0.006], revised_opacity=True)
    _see(strategy, [1e-3, 1e-3, 0.0, 1e-3])
    strategy.after_step(ROUND, parameters)
    x = parameters.values["means"].detach()[:, 0]
    opacities = torch.sigmoid(parameters.values["logit_opacities"].detach())
    through = [float(torch.prod(1 - opacities[(x - 10 * g).abs() < 4])) for g in range(4)]
    assert through == pytest.approx([0.5, 0.04, 0.5, 0.994], rel=1e-5)


def test_rows_removed_by_others_leave_the_statistics_of_the_rest():
    strategy, _ = _setting([SMALL] * 3, [0.5] * 3)
    _see(strategy, [1e-3, 0.0, 2e-3])
    strategy.keep_rows(torch.tensor([0, 2]))
    torch.testing.assert_close(strategy.state()["pull"], torch.tensor([1e-3, 2e-3]))


def test_state_carries_the_statistics():
    strategy, parameters = _setting([SMALL, SMALL], [0.5, 0.5])
    _see(strategy, [1e-3, 0.0])
    twin, _ = _setting([SMALL, SMALL], [0.5, 0.5])
    twin.load_state(strategy.state())
    twin.after_step(ROUND, parameters)
    assert len(parameters) == 3


def test_around_a_far_sphere_gaussians_may_grow_with_the_distance():
    """Sizes of 0.3 extents: removed in the scene, and, 5 extents away, only if there is no such sphere."""
    kept = {}
    for name, middle in (("none", None), ("sphere", torch.zeros(3))):
        strategy, parameters = _setting([0.3, 0.3, SMALL], [0.5] * 3)
        strategy._middle = middle
        with torch.no_grad():
            parameters.values["means"][1, 1] = 5.0 * EXTENT
        strategy.after_step(ROUND, parameters)
        kept[name] = sorted(parameters.values["means"][:, 0].tolist())
    assert kept == {"none": [20.0], "sphere": [10.0, 20.0]}
