"""What speaks against a model, on made-up matches: contradictions, turns on the spot, planes."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.structure.cameras import SharedCameras
from graphgs.structure.contradictions import PointLookup, project, support_of
from graphgs.structure.evidence import VerifiedMatches
from graphgs.structure.flatness import flat_and_frontal, thickness
from graphgs.structure.rotation_only import fit_rotations
from graphgs.structure.soundness import Witness
from tests.support.corner_scene import photo

CAMERA = Camera("RADIAL", 640, 480, (500.0, 320.0, 240.0, -0.05, 0.01))


def model(count: int = 6, points: int = 80, seed: int = 0) -> Reconstruction:
    """Cameras in a row, all of which see all points."""
    rng = np.random.default_rng(seed)
    rotations = Rotation.from_rotvec(rng.normal(0, 0.05, (count, 3))).as_matrix()
    centers = np.stack([np.arange(count) * 0.5, rng.normal(0, 0.1, count), rng.normal(0, 0.1, count)], axis=1)
    bare = Reconstruction(
        cameras=(CAMERA,),
        names=tuple(f"{k:02d}.jpg" for k in range(count)),
        camera_ids=np.zeros(count, np.int64),
        rotations=rotations,
        translations=-np.einsum("nij,nj->ni", rotations, centers),
        points=np.column_stack([rng.uniform(0, 2.5, points), rng.uniform(-1, 1, points), rng.uniform(6, 10, points)]),
    )
    image = np.tile(np.arange(count), points)
    seen = project(bare, image, np.repeat(bare.points, count, axis=0)).astype(np.float32)
    return dataclasses.replace(
        bare,
        colors=np.zeros((points, 3), np.uint8),
        errors=np.zeros(points),
        track_offsets=np.arange(points + 1) * count,
        track_images=image.astype(np.int32),
        track_xy=seen.astype(np.float64),
    )


def matches(found: Reconstruction, *, wrong: dict[tuple[int, int], int] | None = None) -> VerifiedMatches:
    """Every photo with the next two. Of the pairs in `wrong`, so many matches lead to a feature of another point."""
    count, points = len(found.names), len(found.points)
    xy = found.track_xy.reshape(points, count, 2).astype(np.float32)
    pairs = sorted({(i, j) for i in range(count) for j in (i + 1, i + 2) if j < count} | set(wrong or {}))
    xy_j = []
    for i, j in pairs:
        order = np.arange(points)
        amount = (wrong or {}).get((i, j), 0)
        order[:amount] = np.roll(np.argsort(xy[:, j, 0]), points // 2)[:amount]
        xy_j.append(xy[order, j])
    return VerifiedMatches(
        np.array(pairs),
        np.arange(len(pairs) + 1) * points,
        np.concatenate([xy[:, i] for i, _ in pairs]),
        np.concatenate(xy_j),
    )


def photos(names: tuple[str, ...], focal_px: float | None = None) -> Photos:
    return Photos(None, tuple(photo(name, name, focal_px=focal_px) for name in names))


def shared(count: int) -> SharedCameras:
    return SharedCameras((CAMERA,), (False,), np.zeros(count, np.int64))


def judge(found: Reconstruction, verified: VerifiedMatches, focal_px: float | None = None):
    rotation = fit_rotations(verified, shared(len(found.names)), focal_known=focal_px is not None)
    return Witness(photos(found.names, focal_px), verified, rotation, 15).judge(found)[0]


def test_projection_is_the_pinhole_with_its_lens():
    found = model(2, 5)
    local = found.rotations[1] @ found.points[3] + found.translations[1]
    x, y = local[:2] / local[2]
    factor = 1 - 0.05 * (x * x + y * y) + 0.01 * (x * x + y * y) ** 2
    expected = [500 * factor * x + 320, 500 * factor * y + 240]
    np.testing.assert_allclose(project(found, np.array([1]), found.points[3:4])[0], expected, atol=1e-9)
    behind = project(found, np.array([0]), np.array([[0.0, 0.0, -5.0]]))
    assert np.isnan(behind).all()


def test_features_find_their_points():
    found = model(3, 7)
    lookup = PointLookup(found)
    xy = found.track_xy.reshape(7, 3, 2)
    np.testing.assert_array_equal(lookup.points(np.full(7, 2), xy[:, 2].astype(np.float32)), np.arange(7))
    assert lookup.points(np.array([0]), np.array([[1.25, 2.5]])).tolist() == [-1]


def test_a_sound_model_supports_all_its_matches():
    found = model()
    support = support_of(found, found.names, matches(found))
    assert (support.supported == 80).all()
    assert support.contradicted_share == 0
    assert judge(found, matches(found)).doubts == ()


def test_photos_are_found_by_name_and_those_without_a_pose_are_passed_over():
    found = model()
    verified = matches(found)
    renamed = ("unplaced.jpg", *found.names)
    moved = dataclasses.replace(verified, pairs=verified.pairs + 1)
    first = support_of(found, found.names, verified)
    second = support_of(found, renamed, moved)
    np.testing.assert_array_equal(first.pairs, second.pairs)
    np.testing.assert_array_equal(first.supported, second.supported)
    assert len(support_of(found, ("x",) * 6, verified).pairs) == 0


def test_one_strong_pair_that_objects_is_enough_to_doubt():
    """The shape of a fold: all pairs fit but one, and that is as strong as any."""
    found = model(12)
    sound = judge(found, matches(found, wrong={(4, 5): 70}))
    assert sound.pair == ("04.jpg", "05.jpg")
    assert sound.pair_matches >= 65  # a few wrong matches end close to the right place
    assert sound.strength > 0.8
    assert sound.contradicted_share < 0.1
    assert "look alike" in sound.doubts[0]


def test_weak_objections_everywhere_are_no_doubt():
    """Real scenes: a few wrong matches in each pair, and weak pairs that are all wrong."""
    found = model(12)
    wrong = {(i, i + 1): 4 for i in range(11)} | {(0, 9): 80, (2, 11): 80}
    verified = matches(found, wrong=wrong)
    weak = [k for k, pair in enumerate(verified.pairs.tolist()) if pair[1] - pair[0] > 2]
    kept = np.ones(len(verified.xy_i), bool)
    for k in weak:
        kept[verified.offsets[k] + 25 : verified.offsets[k + 1]] = False
    sizes = [25 if k in weak else 80 for k in range(len(verified.pairs))]
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    thinned = VerifiedMatches(verified.pairs, offsets, verified.xy_i[kept], verified.xy_j[kept])
    sound = judge(found, thinned)
    assert 0 < sound.contradicted_share < 0.1
    assert sound.doubts == ()


def test_many_objections_are_a_doubt_though_none_is_strong():
    found = model(12)
    sound = judge(found, matches(found, wrong={(i, j): 20 for i in range(12) for j in (i + 1, i + 2) if j < 12}))
    assert sound.strength < 0.4
    assert sound.contradicted_share > 0.1
    assert "contradict the poses" in sound.doubts[0]


def test_an_empty_model_is_doubted():
    found = model(6, 8)
    assert "hardly any points" in judge(found, matches(found)).doubts[0]


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("scale", [0.6, 1.0, 1.6])
def test_a_turn_on_the_spot_is_seen_at_any_focal_length(scale, known):
    """What EXIF tells may be wrong."""
    found = model(6, 80)
    turns = Rotation.from_rotvec(np.outer(np.arange(6), [0.01, 0.12, 0.0])).as_matrix()
    still = dataclasses.replace(
        found,
        rotations=turns,
        translations=np.zeros((6, 3)),
        cameras=(Camera.pinhole(640, 480, 500 * scale, 500 * scale, 320, 240),),
    )
    image = np.tile(np.arange(6), 80)
    spread = np.column_stack([found.points[:, 0] - 1.2, found.points[:, 1], found.points[:, 2]])
    noise = np.random.default_rng(1).normal(0, 0.3, (480, 2))
    seen = project(still, image, np.repeat(spread, 6, axis=0)) + noise
    verified = matches(dataclasses.replace(still, points=spread, track_xy=seen))
    fit = fit_rotations(verified, shared(6), focal_known=known)
    assert fit.on_the_spot
    assert fit.share == 1.0
    with_parallax = fit_rotations(matches(found), shared(6), focal_known=known)
    assert with_parallax.share == 0.0


def test_a_walk_along_a_plane_is_no_turn_if_the_focal_length_is_known():
    """A survey from above: at an endless focal length a turn would explain it."""
    found = model(6, 80)
    walk = dataclasses.replace(
        found,
        rotations=np.tile(np.eye(3), (6, 1, 1)),
        translations=-np.stack([0.9 * np.arange(6), np.zeros(6), np.zeros(6)], axis=1),
        cameras=(Camera.pinhole(640, 480, 500, 500, 320, 240),),
    )
    ground = np.column_stack([found.points[:, :2], np.full(80, 8.0)])
    seen = project(walk, np.tile(np.arange(6), 80), np.repeat(ground, 6, axis=0))
    verified = matches(dataclasses.replace(walk, points=ground, track_xy=seen))
    assert fit_rotations(verified, shared(6), focal_known=False).open
    fit = fit_rotations(verified, shared(6), focal_known=True)
    assert not fit.on_the_spot
    assert not fit.open


def test_nothing_matched_is_no_turn():
    empty = VerifiedMatches(np.zeros((0, 2), np.int64), np.zeros(1, np.int64), np.zeros((0, 2)), np.zeros((0, 2)))
    assert not fit_rotations(empty, shared(3), focal_known=False).on_the_spot


def test_thickness_of_a_plane_a_box_and_a_plane_with_outliers():
    rng = np.random.default_rng(0)
    plane = rng.uniform(-1, 1, (500, 3)) * [1, 1, 1e-4]
    turned = Rotation.from_rotvec([0.3, 0.7, -0.2]).apply(plane) + [3, 4, 5]
    assert thickness(plane) < 1e-3
    assert thickness(turned) == pytest.approx(thickness(plane), rel=1e-6)
    assert thickness(rng.uniform(-1, 1, (500, 3))) > 0.3
    dirty = np.concatenate([plane, rng.uniform(-1, 1, (30, 3))])
    assert thickness(dirty) < 1e-2
    assert thickness(plane[:3]) == 0.0


def test_a_plane_counts_only_where_it_is_seen_from_one_direction_and_the_focal_length_is_not_told():
    found = model(6, 80)
    flat = dataclasses.replace(found, points=found.points * [1, 1, 0] + [0, 0, 8])
    seen = project(flat, np.tile(np.arange(6), 80), np.repeat(flat.points, 6, axis=0))
    flat = dataclasses.replace(flat, track_xy=seen.astype(np.float32).astype(np.float64))
    assert flat_and_frontal(flat)
    assert not flat_and_frontal(found)
    around = Rotation.from_rotvec(np.array([[0, a, 0] for a in np.linspace(-0.6, 0.6, 6)])).as_matrix()
    assert not flat_and_frontal(dataclasses.replace(flat, rotations=around))
    assert any("in one plane" in doubt for doubt in judge(flat, matches(flat)).doubts)
    assert not any("in one plane" in doubt for doubt in judge(flat, matches(flat), focal_px=500.0).doubts)
