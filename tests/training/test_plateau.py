"""Stopping where training no longer gets anywhere."""

import pytest

from graphgs.training import train
from graphgs.training.config import TrainConfig
from graphgs.training.plateau import has_settled
from graphgs.training.schedule import Schedule
from tests.support.tiny_scene import COUNT, tiny_scene

SETTLING = TrainConfig(steps=1000, consistency="none", plateau_steps=100, plateau_gain=0.01)


def _curve(end: int, slope: float) -> list[dict]:
    """A loss that falls by `slope` (relative) per hundred steps."""
    return [{"step": step, "loss": 1.0 - slope * step / 100} for step in range(10, end + 1, 10)]


@pytest.mark.parametrize(("slope", "expected"), [(0.0, True), (0.005, True), (0.03, False), (-0.1, True)])
def test_gain_decides(slope, expected):
    assert has_settled(SETTLING, Schedule(SETTLING), _curve(900, slope)) is expected


def test_not_before_two_windows_of_settled_steps():
    schedule = Schedule(SETTLING)
    assert schedule.settled_from == 500  # the last densification
    assert [has_settled(SETTLING, schedule, _curve(end, 0.0)) for end in (690, 700)] == [False, True]


def test_off_by_default():
    config = TrainConfig(steps=1000)
    assert not has_settled(config, Schedule(config), _curve(1000, 0.0))


def test_a_run_ends_early_and_a_resumed_one_at_the_same_step(tmp_path_factory, tmp_path):
    scene = tiny_scene(tmp_path_factory.mktemp("scene"))
    config = TrainConfig(steps=100, max_splats=COUNT, consistency="none", plateau_steps=10, plateau_gain=0.9)

    def run(folder, **options):
        return train(config, scene.views, scene.graph, scene.points, scratch=tmp_path / folder, threads=1, **options)

    whole = run("whole").stats.steps_executed
    run("parts", stop_at=55)
    assert run("parts").stats.steps_executed == run("parts").stats.steps_executed == whole == 70
