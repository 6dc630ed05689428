"""What counts as the right shape, and what as having said what is wrong."""

import dataclasses

import pytest

from bench.shape_measures import Measures
from bench.shape_ours import error_in, status_of
from bench.shape_verdict import defects, judge

RIGHT = Measures(
    photos=40, placed=40, diameter=200.0, position_median=0.05, position_largest=0.3, rotation_median=0.02,
    rotation_p99=0.1, focal=0.4, local_scale=0.5, bend=0.3, scatter=0.1,
)  # fmt: skip
STRETCHED = dataclasses.replace(RIGHT, focal=-8.0)
BENT = dataclasses.replace(RIGHT, bend=14.5, position_median=1.5, local_scale=3.0)
JUMP = dataclasses.replace(RIGHT, local_scale=80.0, position_largest=9.0)
SAYS_STRETCH = "the focal length is not shown by the photos: the drive may be stretched by 12 %"
SAYS_BEND = "heights may bend by 2 m over this flight"


def test_what_is_wrong_is_named():
    assert defects(RIGHT) == ()
    assert defects(STRETCHED) == ("stretch",)
    assert defects(BENT) == ("bend", "scale", "position")
    assert defects(JUMP) == ("scale", "position")
    assert defects(dataclasses.replace(RIGHT, focal=None, bend=None, placed=37)) == ("photos missing",)


@pytest.mark.parametrize(
    ("measures", "cautions", "word"),
    [
        (RIGHT, (), "right"),
        (RIGHT, (SAYS_STRETCH,), "right"),
        (STRETCHED, (), "WRONG AND SILENT"),
        (STRETCHED, (SAYS_STRETCH,), "wrong, cautioned"),
        (STRETCHED, (SAYS_BEND,), "WRONG AND SILENT"),
        (BENT, (SAYS_STRETCH,), "WRONG AND SILENT"),
        (BENT, (SAYS_BEND,), "wrong, cautioned"),
        (JUMP, ("photos 1 to 20 came out 1.8 times too large",), "wrong, cautioned"),
        (JUMP, ("two photos are blurred",), "WRONG AND SILENT"),
    ],
)
def test_only_the_true_defect_counts_as_said(measures, cautions, word):
    verdict = judge(measures, "caution" if cautions else "ok", cautions, determined=False)
    assert verdict.word == word
    assert verdict.good == (word != "WRONG AND SILENT")
    assert not verdict.needless


def test_photos_that_tell_their_shape_need_no_caution():
    assert judge(RIGHT, "caution", (SAYS_STRETCH,), determined=True).needless
    assert not judge(RIGHT, "ok", (), determined=True).needless


def test_a_scene_in_part_or_none_is_not_good():
    assert not judge(dataclasses.replace(RIGHT, placed=12), "ok", (), determined=True).good
    assert not judge(None, "refused", (), determined=False).good
    assert not judge(RIGHT, "failed", (), determined=True).good
    refused = judge(JUMP, "partial", (), determined=True)  # ended with an error: neither good nor silent
    assert (refused.word, refused.good) == ("refused", False)


def test_how_a_run_ended_in_one_word():
    assert status_of(0, {"status": "posed", "cautions": []}) == "ok"
    assert status_of(0, {"status": "posed", "cautions": [SAYS_BEND]}) == "caution"
    assert status_of(3, {"status": "partial", "cautions": []}) == "partial"
    assert status_of(3, {}) == "refused"
    assert status_of(-9, {}) == status_of(1, {}) == "failed"
    assert error_in("[1/7] Photos\nerror: no two photos match\n       take more\n") == "no two photos match"
    assert error_in("done: 3 of 3 photos placed\n") == ""
