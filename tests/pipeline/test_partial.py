"""What is said of poses that were not accepted: how many, and whether those there are can be trusted."""

from types import SimpleNamespace

import pytest

from graphgs.pipeline import Posed, partial_error
from graphgs.structure.acceptance import Agreement
from graphgs.structure.config import StructureConfig

AGREED = Agreement(common=20, rotation_median_deg=0.1, rotation_p99_deg=0.5, largest_shift=0.001)
DISAGREED = Agreement(common=20, rotation_median_deg=0.5, rotation_p99_deg=27.0, largest_shift=0.27)


def posed(agreement: Agreement | None, *, component: int = 24, doubts: tuple[str, ...] = ()) -> Posed:
    """20 of 24 photos placed."""
    structure = SimpleNamespace(
        reconstruction=SimpleNamespace(names=("photo",) * 20),
        component=component,
        agreement=agreement,
        compared_with="the coarse reconstruction",
        doubts=doubts,
    )
    return Posed(SimpleNamespace(photos=(None,) * 24), structure, views=None, graph=None)


def test_too_few_but_sound_poses_may_be_trained_on():
    error = partial_error(posed(AGREED), StructureConfig())
    assert error.exit_code == 3
    assert "20 of 24 photos" in error.message
    assert "agree" not in error.message
    assert "doubtful" not in error.hint
    assert "--allow-partial" in error.hint


@pytest.mark.parametrize("agreement", [DISAGREED, None])
def test_poses_that_fail_agreement_are_called_doubtful(agreement):
    error = partial_error(posed(agreement), StructureConfig())
    assert "do not agree with the coarse reconstruction" in error.message
    assert "doubtful" in error.hint


def test_a_group_apart_is_counted():
    assert (
        "largest group with common features holds 21"
        in partial_error(posed(AGREED, component=21), StructureConfig()).message
    )


def test_doubts_are_told_although_two_reconstructions_agree():
    error = partial_error(posed(AGREED, doubts=("parts of the scene look alike",)), StructureConfig())
    assert "do not agree" not in error.message
    assert "parts of the scene look alike" in error.message
    assert "doubtful" in error.hint
