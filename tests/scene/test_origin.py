"""Scenes far from zero: moved near it where float32 would be too coarse, and back again."""

import numpy as np
from scipy.spatial.transform import Rotation

from graphgs.scene.camera import Camera
from graphgs.scene.origin import AT_ZERO, FAR, moved, moved_back, near_zero, origin_for
from graphgs.scene.reconstruction import Reconstruction

UTM = (453210.0, 5412345.0, 312.0)


def scene(shift=(0.0, 0.0, 0.0), *, seed: int = 0) -> Reconstruction:
    """20 cameras within some 10 m, 500 points around them, at `shift`."""
    rng = np.random.default_rng(seed)
    rotations = Rotation.random(20, random_state=seed).as_matrix()
    centers = np.round(rng.normal(scale=5.0, size=(20, 3)) * 2**20) / 2**20 + shift
    return Reconstruction(
        cameras=(Camera.pinhole(64, 48, 50, 50, 32, 24),),
        names=tuple(f"{k:02d}.png" for k in range(20)),
        camera_ids=np.zeros(20, np.int64),
        rotations=rotations,
        translations=-np.einsum("nij,nj->ni", rotations, centers),
        points=np.round(rng.normal(scale=20.0, size=(500, 3)) * 2**20) / 2**20 + shift,
    )


def test_a_scene_near_zero_stays_as_it_is():
    near = scene((12.0, -7.0, 2.0))
    found, origin = near_zero(near)
    assert origin == AT_ZERO
    assert found is near
    assert origin_for(np.zeros((0, 3))) == AT_ZERO
    assert origin_for(np.full((3, 3), 1e6)) == AT_ZERO  # no extent to say what far is


def test_the_limit_is_what_float32_can_still_step():
    rng = np.random.default_rng(1)
    centers = rng.normal(size=(200, 3))
    extent = np.median(np.linalg.norm(centers - np.median(centers, axis=0), axis=1))
    for times, is_far in ((0.9, False), (1.2, True)):
        place = np.array([times * FAR * extent, 0.0, 0.0])
        assert (origin_for(centers + place) != AT_ZERO) == is_far
    last_step = np.float32(1.6e-6 * extent)  # of training
    assert np.float32(FAR * extent) + last_step != np.float32(FAR * extent)


def test_utm_positions_come_near_zero_and_lose_nothing():
    far = scene(UTM)
    found, origin = near_zero(far)
    assert np.abs(found.centers).max() < 30
    np.testing.assert_array_equal(found.points + origin, far.points)  # the subtraction is exact
    np.testing.assert_array_equal(found.points, scene().points + (np.array(UTM) - origin))
    np.testing.assert_allclose(found.centers, scene().centers + (np.array(UTM) - origin), atol=1e-7)
    assert len(np.unique(far.points[:, 1].astype(np.float32))) < 200
    assert len(np.unique(found.points.astype(np.float32), axis=0)) == 500


def test_moving_back_gives_the_input():
    far = scene(UTM)
    found, origin = near_zero(far)
    back = moved_back(found, origin)
    np.testing.assert_array_equal(back.points, far.points)
    np.testing.assert_allclose(back.centers, far.centers, atol=1e-6)
    np.testing.assert_allclose(back.translations, far.translations, atol=1e-6)
    np.testing.assert_array_equal(back.rotations, far.rotations)


def test_what_a_camera_sees_stays():
    far = scene(UTM)
    near = moved(far, UTM)
    for k in range(3):
        seen = far.points @ far.rotations[k].T + far.translations[k]
        np.testing.assert_allclose(near.points @ near.rotations[k].T + near.translations[k], seen, atol=1e-6)
