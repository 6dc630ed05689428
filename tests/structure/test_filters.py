"""The pair filters: the printed table cell by cell, and what each form keeps and drops on simulated cameras."""

import itertools
import logging

import numpy as np
import pytest

from graphgs.structure import filter_pairs
from graphgs.structure.filters import _say_once
from graphgs.structure.quadrants import ACCEPTED, LOOSE, ORIENTATION_QUADRANT, POSITION_QUADRANT, STRICT
from tests.support import camera_tracks as tracks
from tests.support.reference import filters as reference

BITS = list(itertools.product((0, 1), repeat=3))
SCENES = {
    "random box": (tracks.random_box(60, 14.0), 20.0),
    "straight": (tracks.straight_track(24), 20.0),
    "curve": (tracks.curve_track(24), 20.0),
    "loop": (tracks.loop_track(24), 20.0),
    "nadir grid": (tracks.nadir_grid(8), 12.0),
}


def _all_pairs(n: int) -> np.ndarray:
    return np.stack(np.triu_indices(n, 1), axis=1)


def _camera_with_direction(direction: np.ndarray) -> np.ndarray:
    down = (0.0, 1.0, 0.0) if abs(direction[1]) < 0.9 else (1.0, 0.0, 0.0)
    return tracks.look(np.asarray(direction, float)[None], down)[0]


@pytest.mark.parametrize(("mode", "table", "cells"), [("strict", STRICT, 12), ("loose", LOOSE, 40)])
def test_all_64_states_of_the_table(mode, table, cells):
    """Cameras in every state, judged through the public function: as printed, and as the closed form says."""
    kept = 0
    d_i = np.array([0.3, -0.5, 0.8])
    d_i /= np.linalg.norm(d_i)
    rng = np.random.default_rng(0)
    directions = {}
    for d_j in rng.normal(size=(4000, 3)):  # every orientation state occurs for this d_i
        d_j /= np.linalg.norm(d_j)
        cross = np.cross(d_i, d_j)
        directions.setdefault((int(d_i @ d_j > 0), int(cross[0] > 0), int(cross[1] > 0)), d_j)
    assert len(directions) == 8
    for (p, position), (o, orientation) in itertools.product(enumerate(BITS), enumerate(BITS)):
        rotations = np.stack([_camera_with_direction(d_i), _camera_with_direction(directions[orientation])])
        centers = np.stack([np.zeros(3), np.where(position, 1.5, -0.5)])
        keep = bool(filter_pairs(np.array([[0, 1]]), rotations, centers, mode=f"paper-{mode}")[0])
        assert keep == (ORIENTATION_QUADRANT[o] in table[POSITION_QUADRANT[p]])
        assert keep == reference.accepted(mode, position, orientation)
        kept += keep
    assert kept == cells == ACCEPTED[mode].sum()


def test_a_zero_component_has_sign_0():
    """Same direction, straight ahead: cross product and sideways offset are exactly zero."""
    rotations = np.stack([np.eye(3)] * 2)
    centers = np.array([[0.0, 0, 0], [0.0, 0, 1]])
    assert reference.accepted("strict", (0, 0, 1), (1, 0, 0)) is False
    assert filter_pairs(np.array([[0, 1]]), rotations, centers, mode="paper-strict").tolist() == [False]
    assert filter_pairs(np.array([[0, 1]]), rotations, centers, mode="paper-loose").tolist() == [True]


def _measured(keep: np.ndarray, overlap: np.ndarray) -> tuple[float, float]:
    """(recall on pairs that share a tenth, share of pairs without any overlap that are dropped)."""
    none = overlap == 0
    return float(keep[overlap >= 0.1].mean()), float((~keep[none]).mean()) if none.any() else 1.0


@pytest.fixture(scope="module")
def overlaps():
    """{scene: [P] true overlap}"""
    result = {}
    for name, ((rotations, centers), far) in SCENES.items():
        pairs = _all_pairs(len(centers))
        result[name] = np.array([reference.overlap(i, j, rotations, centers, far=far) for i, j in pairs])
    return result


@pytest.mark.parametrize("scene", SCENES)
def test_frustum_keeps_what_overlaps_and_drops_most_of_the_rest(scene, overlaps):
    (rotations, centers), far = SCENES[scene]
    pairs = _all_pairs(len(centers))
    keep = filter_pairs(pairs, rotations, centers, mode="frustum", fov_deg=60.0, depth_range=(0.5, far))
    recall, dropped = _measured(keep, overlaps[scene])
    assert recall == 1.0
    assert dropped > 0.7  # the margin for coarse poses costs the rest
    octant = _measured(filter_pairs(pairs, rotations, centers, mode="octant"), overlaps[scene])
    assert octant[0] > 0.95
    assert dropped > octant[1]
    strict = _measured(filter_pairs(pairs, rotations, centers, mode="paper-strict"), overlaps[scene])
    assert strict[0] < 0.6  # why the printed strict table is not the default


def test_frustum_survives_noisy_poses(overlaps):
    """Up to 0.3 rad and 0.3 units of noise on the prior, the paper's own test: recall over all scenes together."""
    kept = total = 0
    for seed, (scene, ((rotations, centers), far)) in itertools.product(range(3), SCENES.items()):
        noisy = tracks.noisy(rotations, centers, angle=0.3, offset=0.3, seed=seed)
        pairs = _all_pairs(len(centers))[overlaps[scene] >= 0.1]
        keep = filter_pairs(pairs, *noisy, mode="frustum", fov_deg=60.0, depth_range=(0.5, far))
        kept, total = kept + keep.sum(), total + len(pairs)
    assert kept / total >= 0.999


@pytest.mark.parametrize("mode", ["octant", "frustum"])
def test_symmetric_and_unchanged_by_a_similarity(mode):
    rotations, centers = tracks.random_box(60)
    pairs = _all_pairs(60)
    for depths in (None, (0.5, 20.0)):
        keep = filter_pairs(pairs, rotations, centers, mode=mode, fov_deg=60.0, depth_range=depths)
        assert 0.1 < keep.mean() < 0.9
        options = {"mode": mode, "fov_deg": 60.0}
        backwards = filter_pairs(pairs[:, ::-1], rotations, centers, depth_range=depths, **options)
        np.testing.assert_array_equal(keep, backwards)
        scaled = None if depths is None else (2.5 * depths[0], 2.5 * depths[1])
        again = filter_pairs(pairs, *tracks.moved(rotations, centers, scale=2.5), depth_range=scaled, **options)
        np.testing.assert_array_equal(keep, again)


def test_paper_judges_the_pair_as_given_in_world_axes():
    rotations, centers = tracks.random_box(200)
    pairs = _all_pairs(200)
    for mode, flips, one_way in (("paper-strict", 0.27, 0.33), ("paper-loose", 0.16, 0.20)):
        keep = filter_pairs(pairs, rotations, centers, mode=mode)
        worlds = [tracks.moved(rotations, centers, seed=seed) for seed in range(12)]
        turned = np.array([filter_pairs(pairs, *world, mode=mode) for world in worlds])
        backwards = filter_pairs(pairs[:, ::-1], rotations, centers, mode=mode)
        assert (keep != turned).mean() == pytest.approx(flips, abs=0.05)
        assert (~backwards[keep]).mean() == pytest.approx(one_way, abs=0.05)


def test_field_of_view_in_every_form():
    rotations, centers = tracks.random_box(40)
    pairs = _all_pairs(40)

    def keep(fov):
        return filter_pairs(pairs, rotations, centers, fov_deg=fov)

    same = keep(50.0)
    for form in ((50.0, 50.0), np.full(40, 50.0), [50.0] * 40, np.full((40, 2), 50.0), np.full((40, 1), 50.0)):
        np.testing.assert_array_equal(keep(form), same)
    assert keep((80.0, 50.0)).sum() > same.sum()
    assert keep(np.where(np.arange(40) < 20, 50.0, 170.0)).sum() > same.sum()
    pair_of_two = filter_pairs(np.array([[0, 1]]), rotations[:2], centers[:2], fov_deg=np.array([50.0, 70.0]))
    assert pair_of_two.shape == (1,)
    with pytest.raises(ValueError, match="fov_deg"):
        keep(np.full(7, 50.0))
    with pytest.raises(ValueError, match=r"degrees in 0\.\.360"):
        keep(-5.0)


def test_unknown_field_of_view_falls_back_to_octant_and_says_so_once(caplog):
    rotations, centers = tracks.random_box(40)
    pairs = _all_pairs(40)
    octant = filter_pairs(pairs, rotations, centers, mode="octant")
    _say_once.cache_clear()
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            np.testing.assert_array_equal(filter_pairs(pairs, rotations, centers, mode="frustum"), octant)
    assert len(caplog.records) == 1
    fov = np.full(40, 60.0)
    fov[3] = np.nan
    mixed, known = filter_pairs(pairs, rotations, centers, fov_deg=fov), (pairs != 3).all(1)
    np.testing.assert_array_equal(mixed[~known], octant[~known])
    np.testing.assert_array_equal(mixed[known], filter_pairs(pairs, rotations, centers, fov_deg=60.0)[known])


def test_depth_range_counts_and_is_checked():
    """Two cameras 10 apart that look at each other share nothing when they see only 2 far."""
    rotations = np.stack([np.eye(3), np.diag([-1.0, 1.0, -1.0])])
    centers = np.array([[0.0, 0, 0], [0.0, 0, 10]])
    pair = np.array([[0, 1]])
    assert filter_pairs(pair, rotations, centers, fov_deg=60, depth_range=(0.1, 9.0)).all()
    assert not filter_pairs(pair, rotations, centers, fov_deg=60, depth_range=(0.1, 2.0)).any()
    assert not filter_pairs(pair, rotations, centers, fov_deg=60, depth_range=np.array([[0.1, 2.0], [0.1, 3.0]])).any()
    for bad in ((3.0, 1.0), (-1.0, 2.0), (0.1, np.inf)):
        with pytest.raises(ValueError, match="near < far"):
            filter_pairs(pair, rotations, centers, fov_deg=60, depth_range=bad)
    with pytest.raises(ValueError, match="depth_range"):
        filter_pairs(pair, rotations, centers, fov_deg=60, depth_range=np.zeros((3, 2)))


def test_empty_and_bad_pairs():
    rotations, centers = tracks.random_box(4)
    for mode in ("paper-strict", "paper-loose", "octant", "frustum"):
        assert filter_pairs(np.zeros((0, 2), int), rotations, centers, mode=mode, fov_deg=60).shape == (0,)
    with pytest.raises(ValueError, match=r"indices in 0\.\.3, got 0\.\.4"):
        filter_pairs(np.array([[0, 4]]), rotations, centers, mode="octant")
    with pytest.raises(ValueError, match="mode"):
        filter_pairs(np.array([[0, 1]]), rotations, centers, mode="sphere")
    with pytest.raises(ValueError, match=r"rotations: expected \[4, 3, 3\]"):
        filter_pairs(np.array([[0, 1]]), rotations[:3], centers)


def test_chunks_give_the_same_answer(monkeypatch):
    rotations, centers = tracks.random_box(40)
    pairs = _all_pairs(40)
    whole = filter_pairs(pairs, rotations, centers, fov_deg=60.0)
    monkeypatch.setattr("graphgs.structure.overlap._CHUNK", 37)
    np.testing.assert_array_equal(filter_pairs(pairs, rotations, centers, fov_deg=60.0), whole)
