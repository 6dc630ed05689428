"""A bowl or a stretch against GPS is seen through its noise, and noise alone is neither."""

import dataclasses

import numpy as np
import pytest

from graphgs.sources.photos import Photo, Photos
from graphgs.structure.gps_shape import gps_shape
from tests.support.lens_scenes import lens_scene

METRE_DEG = 1 / 111_320.0


def flight(tmp_path, *, bowl_m=0.0, stretch=0.0, noise_m=(1.5, 1.0), line=False, altitude=True, seed=0):
    """A flight of 36 photos over 360 m, bent and stretched in the reconstruction; the positions have GPS's noise."""
    rng = np.random.default_rng(seed)
    scene = lens_scene("flat")
    true = 20.0 * scene.centers
    if line:
        true[:, 1] = 0.0
    told = true + rng.normal(0, 1, true.shape) * [noise_m[0], noise_m[0], noise_m[1]]
    photo = Photo("", "", 800, 600, 800, 600, None, None, "one", "", None, None)
    photos = tuple(
        dataclasses.replace(
            photo,
            name=name,
            gps=(45.0 + y * METRE_DEG, x * METRE_DEG / np.cos(np.pi / 4), 300.0 + z if altitude else 0.0),
        )
        for name, (x, y, z) in zip(scene.names, told, strict=True)
    )
    bent = true.copy()
    bent[:, 0] *= 1.0 + stretch
    radius2 = (true[:, :2] ** 2).sum(1)
    bent[:, 2] += bowl_m * radius2 / np.percentile(radius2, 95)
    centers = bent / 37.0  # an arbitrary scale
    model = dataclasses.replace(scene, translations=-np.einsum("nij,nj->ni", scene.rotations, centers))
    return model, Photos(tmp_path, photos)


@pytest.mark.parametrize("bowl", [-12.0, 4.0])
def test_a_bowl_is_measured(tmp_path, bowl):
    found = gps_shape(*flight(tmp_path, bowl_m=bowl))
    assert found.bends
    assert found.bend_m == pytest.approx(bowl, abs=4 * found.bend_deviation_m)
    assert found.scatter_m == pytest.approx(1.0, rel=0.4)
    assert not found.stretches
    (said,) = found.describe()
    assert f"{abs(found.bend_m):.1f} m" in said


def test_a_stretch_is_measured(tmp_path):
    found = gps_shape(*flight(tmp_path, stretch=0.1))
    assert found.stretches
    assert found.stretch == pytest.approx(0.1, abs=0.02)
    assert not found.bends


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_no_shape(tmp_path, seed):
    found = gps_shape(*flight(tmp_path, seed=seed, noise_m=(3.0, 2.0)))
    assert not found.bends
    assert not found.stretches
    assert found.describe() == ()


def test_a_single_track_or_missing_altitudes_tell_nothing(tmp_path):
    assert gps_shape(*flight(tmp_path, line=True)) is None
    assert gps_shape(*flight(tmp_path, altitude=False)) is None
