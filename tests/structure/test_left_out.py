"""Why photos are left out: made-up numbers, rendered photos, and the bridge that would join a group."""

import dataclasses

import cv2
import numpy as np
import pytest

from graphgs.sources.photos import Photos
from graphgs.structure.evidence import TriedPairs
from graphgs.structure.groups import Bridge, best_bridge, named_groups
from graphgs.structure.left_out import PhotoEvidence, left_out
from graphgs.structure.sharpness import Sharpness, measure_sharpness, sharpness
from tests.support.corner_scene import corner_scene, photo


def evidence(**last) -> PhotoEvidence:
    """Ten ordinary photos that were placed, and one that was not: ordinary too, but for what is given."""
    rng = np.random.default_rng(0)
    n = 11
    ordinary = {
        "group": np.zeros(n, np.int64),
        "sharpness": 20 * np.exp(rng.normal(0, 0.15, n)),
        "edge_px": np.full(n, 1.0),
        "contrast": 50 * np.exp(rng.normal(0, 0.1, n)),
        "features": (2000 * np.exp(rng.normal(0, 0.2, n))).astype(int),
        "tried": np.full(n, 12),
        "verified": np.full(n, 9),
        "closest": np.full(n, 8),
        "mutual": np.ones(n),
        "seen": np.full(n, 400),
    }
    for name, value in last.items():
        ordinary[name][-1] = value
    placed = np.arange(n) < n - 1
    sharp = Sharpness(*(ordinary.pop(name) for name in ("sharpness", "contrast", "edge_px")))
    return PhotoEvidence(names=tuple(f"{k:02d}.jpg" for k in range(n)), placed=placed, sharp=sharp, **ordinary)


def cause(**last) -> str:
    (entry,) = left_out(evidence(**last))
    assert entry.name == "10.jpg"
    return entry.cause


@pytest.mark.parametrize(
    ("last", "expected"),
    [
        ({"sharpness": 4.0, "features": 300}, "blur"),
        ({"sharpness": 4.0, "features": 300, "group": 1}, "blur"),  # what is wrong with the photo itself comes first
        ({"sharpness": 4.0, "contrast": 6.0, "features": 40}, "texture"),  # a blank wall is not blurred
        ({"features": 40, "group": 1}, "texture"),
        ({"group": 1, "verified": 0}, "no overlap"),
        ({"verified": 8, "mutual": 0.2}, "repetition"),
        ({"verified": 3, "mutual": 0.0, "seen": 400}, "pose"),  # three partners are too few to tell
        ({"seen": 12}, "triangulation"),
        ({}, "pose"),
        ({"sharpness": 12.0}, "pose"),  # softer than the others, as photos are
        ({"sharpness": np.nan, "contrast": np.nan, "edge_px": np.nan}, "pose"),
        ({"edge_px": 6.0}, "blur"),  # whatever the others are like
        ({"edge_px": 4.0}, "pose"),
    ],
)
def test_the_first_cause_that_applies(last, expected):
    assert cause(**last) == expected


def test_blur_is_relative_to_the_set():
    """Where the placed photos differ as much, a soft one is nothing special; nor is one among soft ones."""
    wide = evidence(sharpness=6.0)
    for values in (np.append(np.geomspace(5, 80, 10), 6.0), np.full(11, 2.0)):
        sharp = dataclasses.replace(wide.sharp, sharpness=values)
        assert left_out(dataclasses.replace(wide, sharp=sharp))[0].cause == "pose"


def test_what_fails_for_a_reason_of_its_own_is_no_want_of_overlap():
    """Where nothing was placed there is nothing to be compared with, and limits that mean something by themselves."""
    nobody = dataclasses.replace(evidence(), placed=np.zeros(11, bool), group=np.arange(11))
    few = np.array([59, 60, *nobody.features[2:]])
    soft = dataclasses.replace(nobody.sharp, edge_px=np.array([1.0, 1.0, 7.3, *np.full(8, 1.0)]))
    crash = {"03.jpg": "matching 03.jpg ends COLMAP's process (SIGSEGV) every time; left out"}
    found = left_out(dataclasses.replace(nobody, features=few, sharp=soft, crashes=crash))
    assert [entry.cause for entry in found[:5]] == ["texture", "no overlap", "blur", "crash", "no overlap"]
    assert "59 features, 60 are needed" in found[0].reason
    assert "edges are 7 px wide" in found[2].reason
    assert found[3].reason == crash["03.jpg"]


def test_groups_are_told_by_their_size():
    several = evidence()
    several = dataclasses.replace(
        several, placed=np.arange(11) < 5, group=np.array([0, 0, 0, 0, 0, 1, 1, 1, 2, 2, 3]), verified=np.zeros(11, int)
    )
    found = {entry.name: entry for entry in left_out(several)}
    assert [found[f"{k:02d}.jpg"].cause for k in range(5, 11)] == [
        *["another group"] * 3, *["tiny group"] * 2, "no overlap"
    ]  # fmt: skip
    assert found["05.jpg"].reason == "belongs to 3 photos apart from the main group: 05.jpg to 07.jpg"
    assert found["08.jpg"].reason == "shares features with 09.jpg alone"
    assert "none of the 12 pairs tried" in found["10.jpg"].reason


def test_nothing_placed_leaves_nothing_to_compare_with():
    nothing = dataclasses.replace(evidence(), placed=np.zeros(11, bool))
    assert {entry.cause for entry in left_out(nothing)} == {"pose"}


def test_blur_takes_sharpness_and_leaves_contrast(tmp_path):
    scene = corner_scene(tmp_path, count=3)
    grey = cv2.imread(str(tmp_path / scene.photos.photos[1].pixels), cv2.IMREAD_GRAYSCALE)
    sharp = measure_sharpness(grey)
    blurred = measure_sharpness(cv2.GaussianBlur(grey, (0, 0), 3))
    shaken = measure_sharpness(cv2.blur(grey, (15, 1)))
    blank = measure_sharpness(np.full_like(grey, 128) + np.random.default_rng(0).integers(0, 3, grey.shape, np.uint8))
    assert blurred.sharpness < 0.2 * sharp.sharpness
    assert shaken.sharpness < 0.5 * sharp.sharpness
    assert blurred.contrast > 0.5 * sharp.contrast
    assert blank.sharpness < 0.1 * sharp.sharpness
    assert blank.contrast < 0.1 * sharp.contrast


def test_masked_pixels_do_not_count():
    rng = np.random.default_rng(0)
    grey = rng.integers(0, 255, (200, 300), np.uint8)
    grey[:, :150] = 90
    mask = np.zeros_like(grey)
    mask[:, :140] = 255
    for hidden in (mask, np.zeros_like(grey)):
        found = measure_sharpness(grey, hidden)
        assert (found.sharpness, found.contrast) == (0.0, 0.0)
        assert np.isnan(found.edge_px)
    assert measure_sharpness(grey).sharpness > 50


def test_only_the_chosen_photos_are_read(tmp_path):
    scene = corner_scene(tmp_path, count=3)
    missing = Photos(tmp_path, (*scene.photos.photos, photo("gone.jpg", "photos/gone.png")))
    found = sharpness(missing, np.array([0, 2]), threads=2)
    for values in (found.sharpness, found.contrast, found.edge_px):
        assert np.isfinite(values).tolist() == [True, False, True, False]


TRIED = TriedPairs(
    pairs=np.array([[0, 1], [1, 2], [1, 3], [2, 4], [3, 4]]),
    matches=np.array([300, 250, 9, 14, 200]),
    inliers=np.array([280, 240, 0, 0, 180]),
)
NAMES = ("a/0.jpg", "a/1.jpg", "a/2.jpg", "b/3.jpg", "b/4.jpg")
MEMBERS = [np.array([0, 1, 2]), np.array([3, 4])]


def test_the_best_bridge_is_the_pair_that_came_closest():
    first, second = named_groups(NAMES, MEMBERS, TRIED, np.zeros((0, 0), np.int64))
    assert (first.name, second.name) == ("a", "b")  # folders of their own
    assert first.bridge is None
    assert second.bridge == Bridge("a/2.jpg", "b/4.jpg", 14)
    assert "from a/2.jpg to b/4.jpg" in second.bridge.advice()


def test_without_any_match_the_bridge_is_the_pair_most_alike():
    untried = TriedPairs(TRIED.pairs[:2], TRIED.matches[:2], TRIED.inliers[:2])
    similar = np.array([[1, 2], [0, 2], [1, 0], [4, -1], [3, 1]])
    assert best_bridge(NAMES, *MEMBERS, untried, similar) == Bridge("a/1.jpg", "b/4.jpg", 0)
    assert best_bridge(NAMES, *MEMBERS, untried, np.full((5, 2), -1)) is None


def test_groups_in_one_folder_are_named_by_their_ends():
    names = tuple(f"{k}.jpg" for k in range(6))
    members = [np.array([0, 2, 5]), np.array([1, 3])]
    groups = named_groups(names, members, TRIED, np.zeros((0, 0), np.int64))
    assert [group.name for group in groups] == ["0.jpg to 5.jpg", "1.jpg to 3.jpg"]
