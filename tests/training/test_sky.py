"""The far sphere: where photos look past all points, in the photos' colours, and nowhere else."""

import dataclasses

import cv2
import numpy as np
import pytest

from graphgs.points import PrunedPoints
from graphgs.scene.views import Views
from graphgs.training import train
from graphgs.training.config import TrainConfig
from graphgs.training.sky import RADIUS, fibonacci_sphere, with_sky
from tests.support.tiny_scene import tiny_scene

WIDTH, HEIGHT = 160, 90
BLUE = (60, 120, 240)


@pytest.fixture
def street(tmp_path):
    """Cameras in a row that look along z; points below the horizon, blue above it."""
    image = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    image[: HEIGHT // 2] = BLUE
    names = tuple(f"{k}.png" for k in range(5))
    for name in names:
        cv2.imwrite(str(tmp_path / name), image[..., ::-1])
    viewmats = np.tile(np.eye(4), (5, 1, 1))
    viewmats[:, 0, 3] = -np.arange(5.0)
    K = np.array([[80.0, 0, WIDTH / 2], [0, 80.0, HEIGHT / 2], [0, 0, 1]])
    views = Views(
        folder=tmp_path,
        names=names,
        images=names,
        masks=(None,) * 5,
        sizes=np.tile([WIDTH, HEIGHT], (5, 1)),
        Ks=np.tile(K, (5, 1, 1)),
        viewmats=viewmats,
        is_test=np.array([True, False, False, False, False]),
    )
    rng = np.random.default_rng(0)
    ground = rng.uniform([-40, 0.2, 2], [40, 8, 20], (4000, 3)).astype(np.float32)
    points = PrunedPoints(
        ground, np.full((4000, 3), 90, np.uint8), np.full(4000, 0.1, np.float32), np.arange(4000), 0.0
    )
    return views, points


def test_the_sky_is_where_no_points_are(street):
    views, points = street
    result = with_sky(points, views, count=3000, extent=2.0, budget_bytes=2**20)
    added = slice(len(points.positions), None)
    far, colors = result.positions[added], result.colors[added]
    assert len(far) > 100
    np.testing.assert_array_equal(result.positions[: len(points.positions)], points.positions)
    middle = np.median(views.centers[1:], axis=0)
    distance = np.linalg.norm(far - middle, axis=1)
    assert distance.min() >= 0.999 * RADIUS * 2.0
    assert distance.max() - distance.min() < 1e-3 * distance.max()
    elevation = -(far - middle)[:, 1] / distance
    assert elevation.min() > -0.05  # nothing below the horizon, where points are
    assert (far[:, 2] > 0).all()  # nothing behind the cameras: nobody has seen it
    assert colors.dtype == np.uint8
    assert np.abs(colors[elevation > 0.2].astype(int) - BLUE).max() <= 1


def test_no_gap_and_no_crowd_between_neighbours(street):
    views, points = street
    result = with_sky(points, views, count=3000, extent=2.0, budget_bytes=2**20)
    scale = result.scales[-1]
    far = result.positions[len(points.positions) :].astype(np.float64)
    nearest = np.sort(np.linalg.norm(far[:, None] - far[None], axis=-1), axis=1)[:, 1]
    assert 1.0 < np.median(nearest) / scale < 3.0


def test_held_out_photos_decide_nothing(street, tmp_path):
    views, points = street
    before = with_sky(points, views, count=500, extent=2.0, budget_bytes=2**20)
    (tmp_path / "0.png").unlink()
    after = with_sky(points, views, count=500, extent=2.0, budget_bytes=2**20)
    np.testing.assert_array_equal(before.colors, after.colors)


def test_a_sphere_is_even():
    sphere = fibonacci_sphere(1000)
    np.testing.assert_allclose(np.linalg.norm(sphere, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(sphere.mean(axis=0), 0.0, atol=2e-3)


def test_a_run_starts_with_it(tmp_path):
    scene = tiny_scene(tmp_path)
    # The tiny scene is black where its blobs are not: half of them taken away leave cells to look through.
    few = dataclasses.replace(
        scene.points,
        positions=scene.points.positions[:4],
        colors=scene.points.colors[:4],
        scales=scene.points.scales[:4],
    )
    config = TrainConfig(steps=1, sky="sphere", sky_points=3000)
    trained = train(config, scene.views, scene.graph, few, scratch=tmp_path / "s", threads=1)
    assert len(trained.splats) > 4
    assert trained.splats.is_finite
