"""The courses of the street: how far they turn, and that the drive follows them."""

import numpy as np
import pytest

from graphgs.synth.course import CORNER_LENGTH, heading_of
from graphgs.synth.drive import Centerline, plan_drive
from graphgs.synth.layout import FOOTWAY

DRIVE = 44.0  # [m]


def line(course: str, *, seed: int = 0) -> Centerline:
    return Centerline(-30.0, DRIVE + 50.0, heading_of(course, DRIVE, seed))


@pytest.mark.parametrize(("course", "degrees"), [("straight", 0.0), ("bend", 30.0), ("corner", 90.0)])
def test_a_drive_turns_by_what_its_course_says(course, degrees):
    for seed in range(3):
        road = line(course, seed=seed)
        assert road.heading(0.0) == 0.0
        assert abs(np.degrees(road.heading(DRIVE))) == pytest.approx(degrees)
    turns = {float(np.sign(line("corner", seed=seed).heading(DRIVE))) for seed in range(8)}
    assert turns == {-1.0, 1.0}  # to either side


def test_a_winding_road_turns_both_ways():
    s = np.linspace(0, 80, 200)
    turn = np.gradient(line("winding").heading(s), s)
    assert turn.min() < -0.01 < 0.01 < turn.max()


def test_a_corner_leaves_room_for_its_footway():
    s = np.linspace(0, DRIVE, 500)
    curvature = np.abs(np.gradient(line("corner").heading(s), s)).max()
    assert 1 / curvature > FOOTWAY + 3.0
    assert CORNER_LENGTH < DRIVE


def test_without_sway_a_straight_drive_never_turns_and_keeps_to_its_line():
    shots = plan_drive(line("straight"), 10, 1, 1.0, seed=3, sway=0.0)
    viewmats = np.stack([shot.viewmat for shot in shots])
    np.testing.assert_array_equal(viewmats[:, :3, :3], np.tile(np.eye(3), (10, 1, 1)))
    np.testing.assert_allclose(-viewmats[:, :3, 3], [[0, -1.6, k] for k in range(10)], atol=1e-9)


def test_less_sway_is_the_same_motion_made_smaller():
    def aside(sway: float) -> np.ndarray:
        return np.array([-shot.viewmat[0, 3] for shot in plan_drive(line("straight"), 9, 1, 1.0, 3, sway=sway)])

    full, small = aside(1.0), aside(0.1)
    assert np.abs(full).max() > 0.4
    assert np.abs(small).max() < 0.25 * np.abs(full).max()
