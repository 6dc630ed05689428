"""What the photos say about a lens, against the normal equations written out whole."""

import dataclasses

import numpy as np
import pytest

from graphgs.structure.calibration.information import lens_information
from graphgs.structure.calibration.projection import LENS, linearise
from tests.support.lens_scenes import lens_scene

ALL = np.ones(len(LENS), bool)
FOCAL = np.array([name == "focal" for name in LENS])


def whole_covariance(scene, noise_px):
    """[5, 5] of the lens, from the dense normal equations of all unknowns with the same weights; the gauge by
    pseudo-inverse."""
    track = np.repeat(np.arange(len(scene.points)), scene.track_lengths)
    images = scene.track_images.astype(np.int64)
    parts = linearise(scene, images, scene.points[track], scene.track_xy)
    weight = np.sqrt(1.0 / (1.0 + (parts.residuals**2).sum(1))) / noise_px
    n, p = len(scene.names), len(scene.points)
    J = np.zeros((2 * len(images), 5 + 6 * n + 3 * p))
    for row, (image, point) in enumerate(zip(images, track, strict=True)):
        here = slice(2 * row, 2 * row + 2)
        J[here, :5] = weight[row] * parts.by_lens[row]
        J[here, 5 + 6 * image : 11 + 6 * image] = weight[row] * parts.by_pose[row]
        first = 5 + 6 * n + 3 * point
        J[here, first : first + 3] = weight[row] * parts.by_point[row]
    scale = np.linalg.norm(J, axis=0)
    scale[:5], scale[scale == 0] = 1.0, 1.0
    J /= scale
    H = J.T @ J
    rest = H[5:, 5:]
    return np.linalg.inv(H[:5, :5] - H[:5, 5:] @ np.linalg.pinv(rest, rcond=1e-12, hermitian=True) @ H[5:, :5])


def thinned(scene, count):
    """The scene with its first points alone."""
    end = scene.track_offsets[count]
    return dataclasses.replace(
        scene,
        points=scene.points[:count],
        colors=scene.colors[:count],
        errors=scene.errors[:count],
        track_offsets=scene.track_offsets[: count + 1],
        track_images=scene.track_images[:end],
        track_xy=scene.track_xy[:end],
    )


@pytest.mark.parametrize("kind", ["bend", "hilly"])
def test_the_information_is_that_of_the_whole_normal_equations(kind):
    scene = thinned(lens_scene(kind), 120)
    found = lens_information(scene)
    expected = whole_covariance(scene, found.noise_px)
    np.testing.assert_allclose(np.linalg.inv(found.information), expected, rtol=2e-3, atol=1e-9)


def test_noise_is_what_the_observations_have():
    assert lens_information(lens_scene("bend", noise_px=0.4)).noise_px == pytest.approx(0.4, rel=0.05)


def test_a_bend_tells_the_focal_length_and_a_straight_drive_does_not():
    bend, straight = (
        float(lens_information(lens_scene(kind)).deviation(FOCAL, FOCAL[None] * 1.0)[0])
        for kind in ("bend", "straight")
    )
    assert bend < 0.003
    assert straight > 10 * bend


def test_flat_ground_seen_from_above_leaves_the_focal_length_open_and_hills_tell_it():
    flat, hilly = (
        float(lens_information(lens_scene(kind)).deviation(FOCAL, FOCAL[None] * 1.0)[0]) for kind in ("flat", "hilly")
    )
    assert hilly < 0.005
    assert flat > 10 * hilly


def test_places_that_disagree_count_more_than_their_number():
    scene = lens_scene("bend")
    pulled = scene.track_xy.copy()
    far = (scene.points[:, 2] > np.median(scene.points[:, 2]))[
        np.repeat(np.arange(len(scene.points)), scene.track_lengths)
    ]
    pulled[far] += 0.01 * (pulled[far] - [400.0, 300.0])  # one half of the scene as through a lens of 1 % longer focus
    effects = FOCAL[None] * 1.0
    clean = lens_information(scene).deviation(FOCAL, effects)[0]
    pulling = lens_information(dataclasses.replace(scene, track_xy=pulled)).deviation(FOCAL, effects)[0]
    assert pulling > 3 * clean


def test_cameras_and_points_move_as_a_wrong_focal_length_has_them():
    """A straight drive absorbs another focal length into depth: points move along the drive, in proportion to it."""
    scene = lens_scene("straight")
    found = lens_information(scene)
    moves = found.point_moves[:, :, 0] - np.median(found.point_moves[:, :, 0], axis=0)
    where = scene.points[found.points] - np.median(scene.points[found.points], axis=0)
    along, across = (float((where[:, k] * moves[:, k]).sum() / (where[:, k] ** 2).sum()) for k in (2, 0))
    assert along - across == pytest.approx(1.0, abs=0.1)
