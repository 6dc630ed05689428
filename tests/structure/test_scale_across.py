"""A reconstruction that broke in two is caught at its weak place, and a sound one is not accused."""

import dataclasses

import numpy as np
import pytest

from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import Similarity
from graphgs.structure.config import StructureConfig
from graphgs.structure.cuts import weakest_cuts
from graphgs.structure.evidence import VerifiedMatches
from graphgs.structure.scale_across import MatchedPoints, scale_across
from graphgs.structure.weak_places import disagreement, weak_places
from tests.support.lens_scenes import lens_scene

SPLIT = 12  # photos before the break


def matches_of(scene) -> VerifiedMatches:
    """Every two photos that see a point, matched there."""
    pairs = {}
    for p in range(len(scene.points)):
        rows = range(scene.track_offsets[p], scene.track_offsets[p + 1])
        for a in rows:
            for b in rows:
                if a < b:
                    pairs.setdefault((int(scene.track_images[a]), int(scene.track_images[b])), []).append((a, b))
    keys = sorted(pairs)
    rows = np.array([entry for key in keys for entry in pairs[key]])
    offsets = np.concatenate([[0], np.cumsum([len(pairs[key]) for key in keys])])
    xy = scene.track_xy.astype(np.float32)
    return VerifiedMatches(np.array(keys), offsets, xy[rows[:, 0]], xy[rows[:, 1]])


def broken(scene, scale, turn_deg=0.0):
    """The first photos, and the points as they see them, larger and turned about the place of the break: points seen
    from both sides are there twice, as after a mapper that dropped what contradicts it."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    rotation = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    about = scene.centers[SPLIT]
    change = Similarity(scale, rotation, about - scale * rotation @ about)
    moved = scene.transformed(change)
    early = np.arange(len(scene.names)) < SPLIT
    points, tracks = [], []
    for p in range(len(scene.points)):
        rows = np.arange(scene.track_offsets[p], scene.track_offsets[p + 1])
        before = early[scene.track_images[rows]]
        for side, where in ((before, moved.points[p]), (~before, scene.points[p])):
            if side.sum() >= 2:
                points.append(where)
                tracks.append(rows[side])
    order = np.concatenate(tracks)
    return dataclasses.replace(
        scene,
        rotations=np.where(early[:, None, None], moved.rotations, scene.rotations),
        translations=np.where(early[:, None], moved.translations, scene.translations),
        points=np.array(points),
        colors=np.zeros((len(points), 3), np.uint8),
        errors=np.full(len(points), 0.3),
        track_offsets=np.concatenate([[0], np.cumsum([len(rows) for rows in tracks])]).astype(np.int64),
        track_images=scene.track_images[order],
        track_xy=scene.track_xy[order],
    )


@pytest.fixture(scope="module")
def scene() -> Reconstruction:
    return lens_scene("bend")


@pytest.fixture(scope="module")
def matches(scene) -> VerifiedMatches:
    return matches_of(scene)


class Seen:
    """Stands for the witness: its photos and matches alone."""

    def __init__(self, scene, matches):
        self.verified = matches
        self.photos = type("Names", (), {"names": scene.names})


def at_break(model, scene, matches):
    side = np.arange(len(scene.names)) < SPLIT
    return scale_across(model, MatchedPoints.of(model, scene.names, matches), side)


def test_a_sound_reconstruction_holds_everywhere(scene, matches):
    places = weak_places(scene, Seen(scene, matches))
    assert len(places) >= 4
    for place in places:
        assert place.holds, place
        assert not place.jumps
        assert not place.is_open
        assert place.ratio == pytest.approx(1.0, abs=5 * place.deviation)


@pytest.mark.parametrize(("scale", "turn"), [(1.8, 0.0), (1.1, 0.0), (1.0, 4.0)])
def test_a_jump_of_scale_or_bearing_is_a_fault_named_by_photos(scene, matches, scale, turn):
    place = at_break(broken(scene, scale, turn), scene, matches)
    assert place.jumps
    assert not place.holds
    assert max(place.ratio, 1 / place.ratio) == pytest.approx(scale, rel=0.03)
    assert place.turn_deg == pytest.approx(turn, abs=0.5)
    assert place.first in place.describe()
    assert place.second in place.describe()
    assert place.photos == SPLIT


def test_a_scale_that_hangs_on_two_points_is_open(scene, matches):
    """Two pieces of road with hardly a point between them."""
    early = scene.track_images < SPLIT
    track = np.repeat(np.arange(len(scene.points)), scene.track_lengths)
    before, after = (np.bincount(track, side, minlength=len(scene.points)) > 0 for side in (early, ~early))
    tying = np.flatnonzero(before & after)
    keep = np.setdiff1d(np.arange(len(scene.points)), tying[2:])
    rows = np.concatenate([np.arange(scene.track_offsets[p], scene.track_offsets[p + 1]) for p in keep])
    lengths = scene.track_lengths[keep]
    torn = dataclasses.replace(
        scene,
        points=scene.points[keep],
        colors=scene.colors[keep],
        errors=scene.errors[keep],
        track_offsets=np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
        track_images=scene.track_images[rows],
        track_xy=scene.track_xy[rows],
    )
    place = at_break(torn, scene, matches_of(torn))
    assert not place.holds
    assert not place.jumps
    assert place.is_open
    assert "fixes the scale" in place.describe()


def test_the_weakest_place_is_cut_first(scene):
    """Photos that overlap less than all others part from each other first."""
    track = np.repeat(np.arange(len(scene.points)), scene.track_lengths)
    early = scene.track_images < SPLIT
    before, after = (np.bincount(track, side, minlength=len(scene.points)) > 0 for side in (early, ~early))
    tying = np.flatnonzero(before & after)
    keep = np.setdiff1d(np.arange(len(scene.points)), np.setdiff1d(tying, tying[::10]))
    rows = np.concatenate([np.arange(scene.track_offsets[p], scene.track_offsets[p + 1]) for p in keep])
    thin = dataclasses.replace(
        scene,
        points=scene.points[keep],
        track_offsets=np.concatenate([[0], np.cumsum(scene.track_lengths[keep])]).astype(np.int64),
        track_images=scene.track_images[rows],
        track_xy=scene.track_xy[rows],
    )
    sides = [set(np.flatnonzero(side)) for side in weakest_cuts(thin)]
    expected = set(range(SPLIT))
    assert expected in sides or set(range(SPLIT, len(scene.names))) in sides


def test_where_another_reconstruction_broke_the_sound_one_is_upheld(scene, matches):
    place = disagreement(scene, broken(scene, 1.8), Seen(scene, matches), StructureConfig())
    assert place.holds
    assert place.photos < SPLIT + 1
    assert disagreement(broken(scene, 1.8), scene, Seen(scene, matches), StructureConfig()).jumps
    assert disagreement(scene, scene, Seen(scene, matches), StructureConfig()) is None
