"""Schedules count executed steps and fit themselves to the length of the run."""

import pytest

from graphgs.training.config import TrainConfig
from graphgs.training.schedule import Schedule


def test_thirty_thousand_steps_are_those_of_3dgs():
    schedule = Schedule(TrainConfig(steps=30_000))
    assert [schedule.sh_degree(step) for step in (0, 999, 1000, 2000, 3000, 29_999)] == [0, 0, 1, 2, 3, 3]
    rounds = [step + 1 for step in range(30_000) if schedule.densifies_after(step)]
    assert (rounds[0], rounds[-1], rounds[1] - rounds[0]) == (500, 14_900, 100)
    resets = [step + 1 for step in range(30_000) if schedule.resets_opacities_after(step)]
    assert resets == [3000, 6000, 9000, 12_000]
    assert [schedule.densify_progress(step) for step in (0, 14_899, 29_999)] == [0.0, 1.0, 1.0]
    first, last = (schedule.rates(step, extent=2.0) for step in (0, 29_999))
    assert first["means"] == pytest.approx(3.2e-4)
    assert last["means"] == pytest.approx(3.2e-6)
    fixed = {"quats": 1e-3, "log_scales": 5e-3, "logit_opacities": 5e-2, "sh_dc": 2.5e-3, "sh_rest": 1.25e-4}
    for rates in (first, last):
        assert {name: rates[name] for name in fixed} == pytest.approx(fixed)


def test_a_short_run_goes_through_every_phase_but_resets():
    schedule = Schedule(TrainConfig(steps=2000))
    assert schedule.sh_degree(1999) == 3
    rounds = [step + 1 for step in range(2000) if schedule.densifies_after(step)]
    assert rounds[0] <= 300
    assert len(rounds) >= 6
    assert not any(schedule.resets_opacities_after(step) for step in range(2000))
    assert any(schedule.has_consistency(step) for step in range(2000))
    whole, short = Schedule(TrainConfig()).rates(29_999, extent=1.0), schedule.rates(1999, extent=1.0)
    strides = {name: short[name] / whole[name] for name in whole}
    assert strides.pop("logit_opacities") == 1.0
    assert strides.pop("means") == pytest.approx(15**0.375)
    assert strides == pytest.approx(dict.fromkeys(strides, 15**0.25))


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_a_tiny_run_has_a_schedule(steps):
    schedule = Schedule(TrainConfig(steps=steps))
    for step in range(steps):
        assert min(schedule.rates(step, extent=1.0).values()) > 0
        assert 0 <= schedule.sh_degree(step) <= 3


@pytest.mark.parametrize(
    ("change", "expected"), [({}, True), ({"consistency": "none"}, False), ({"lambda_consistency": 0.0}, False)]
)
def test_consistency_can_be_switched_off(change, expected):
    schedule = Schedule(TrainConfig(steps=100, **change))
    assert any(schedule.has_consistency(step) for step in range(100)) is expected
    assert not schedule.has_consistency(0)
