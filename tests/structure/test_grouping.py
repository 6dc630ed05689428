"""Which group is kept, and when what is left out makes the result a part."""

import numpy as np
import pytest

from graphgs.structure.evidence import TriedPairs
from graphgs.structure.grouping import Grouping, decide_groups

NOTHING_TRIED = TriedPairs(np.zeros((0, 2), np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64))


def decide(*sizes: int, placed: range, share: float = 0.05) -> Grouping:
    """Groups of so many photos each, in chains, one after the other."""
    ends = np.cumsum(sizes)
    edges = [(k, k + 1) for k in range(ends[-1] - 1) if k + 1 not in ends]
    return decide_groups(
        tuple(f"{k:03d}.jpg" for k in range(ends[-1])),
        np.array(edges, np.int64).reshape(-1, 2),
        np.isin(np.arange(ends[-1]), placed),
        NOTHING_TRIED,
        np.full((ends[-1], 0), -1),
        max_apart_share=share,
    )


@pytest.mark.parametrize("kept", [0, 1])
def test_of_two_groups_as_large_the_reconstructed_one_is_kept(kept):
    found = decide(14, 14, placed=range(14 * kept, 14 * kept + 14))
    assert found.kept.photos[0] == f"{14 * kept:03d}.jpg"
    assert found.groups[1].photos[0] == f"{14 - 14 * kept:03d}.jpg"
    assert not found.is_whole
    names = tuple(f"{k:03d}.jpg" for k in range(28))
    assert (found.labels(names) == 0).tolist() == [(k >= 14) == bool(kept) for k in range(28)]
    assert Grouping.from_record(found.record()) == found


def test_the_smaller_group_is_kept_where_only_it_could_be_reconstructed():
    found = decide(12, 10, placed=range(12, 22))
    assert found.kept.photos[0] == "012.jpg"
    assert found.apart == 12
    assert "kept is the group 012.jpg to 021.jpg (10 photos)" in found.describe()
    assert "000.jpg to 011.jpg (12 photos)" in found.describe()


@pytest.mark.parametrize(
    ("sizes", "share", "whole"),
    [
        ((20,), 0.05, True),
        ((20, 2), 0.05, True),  # two photos are no scene
        ((20, 3), 0.05, False),
        ((20, 2, 2), 0.05, False),
        ((76, 4), 0.05, True),  # 5 % of 80
        ((75, 5), 0.05, False),
        ((75, 5), 0.1, True),
        ((20, *[1] * 12), 0.05, True),  # single photos that fit nothing
        ((10, *[1] * 12), 0.05, False),  # but not the most
    ],
)
def test_what_makes_a_part(sizes, share, whole):
    assert decide(*sizes, placed=range(sizes[0]), share=share).is_whole == whole


def test_photos_that_the_model_places_all_the_same_are_not_missing():
    assert decide(12, 5, placed=range(17)).is_whole


def test_given_poses_hold_everything_together():
    assert Grouping.one(("a.jpg", "b.jpg")).is_whole
