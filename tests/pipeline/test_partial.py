"""What is said of a part: how many photos, which groups, and whether the poses there are can be trusted."""

from types import SimpleNamespace

import pytest

from graphgs.structure.acceptance import Agreement
from graphgs.structure.config import StructureConfig
from graphgs.structure.grouping import Grouping
from graphgs.structure.groups import Bridge, Group
from graphgs.structure.result import Structure
from graphgs.structure.shortfall import partial_error

AGREED = Agreement(common=20, rotation_median_deg=0.1, rotation_p99_deg=0.5, largest_shift=0.001)
DISAGREED = Agreement(common=20, rotation_median_deg=0.5, rotation_p99_deg=27.0, largest_shift=0.27)
NAMES = tuple(f"{k:02d}.jpg" for k in range(24))
ALL = Grouping((Group("street", NAMES),), (), 0, 2)
TWO_ROOMS = Grouping(
    (Group("kitchen", NAMES[:14]), Group("hall", NAMES[14:], Bridge("03.jpg", "17.jpg", 9))), (), 10, 2
)  # fmt: skip


def structure(
    grouping: Grouping = ALL, *, placed: int = 24, agreement: Agreement | None = AGREED, doubts: tuple[str, ...] = ()
) -> Structure:
    enough = placed >= 0.95 * len(grouping.kept.photos)
    diagnosis = SimpleNamespace(soundness=SimpleNamespace(doubts=doubts), blur="")
    return Structure(
        SimpleNamespace(names=NAMES[:placed]), None, None, agreement is AGREED and enough and not doubts, "by hand",
        agreement, "the coarse reconstruction", grouping, (), diagnosis=diagnosis,
    )  # fmt: skip


def error(*arguments, **options):
    return partial_error(structure(*arguments, **options), len(NAMES), StructureConfig())


def test_nothing_is_said_of_what_is_whole():
    assert error() is None


def test_too_few_but_sound_poses_may_be_trained_on():
    found = error(placed=20)
    assert found.exit_code == 3
    assert found.message == "PARTIAL: 20 of 24 photos placed; 24 of them hang together"
    assert "doubtful" not in found.hint
    assert "--allow-partial" in found.hint


@pytest.mark.parametrize("agreement", [DISAGREED, None])
def test_poses_that_fail_agreement_are_called_doubtful(agreement):
    found = error(agreement=agreement)
    assert "do not agree with the coarse reconstruction" in found.message
    assert "doubtful" in found.hint


def test_a_group_apart_makes_sound_poses_a_part():
    found = error(TWO_ROOMS, placed=14)
    assert found.message == (
        "PARTIAL: 14 of 24 photos placed; kept is the group kitchen (14 photos); "
        "without common features with it: hall (10 photos)"
    )
    assert "from 03.jpg to 17.jpg" in found.hint
    assert "doubtful" not in found.hint


def test_doubts_are_told_although_two_reconstructions_agree():
    found = error(doubts=("parts of the scene look alike",))
    assert "do not agree" not in found.message
    assert "parts of the scene look alike" in found.message
    assert "doubtful" in found.hint
