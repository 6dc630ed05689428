"""The points stage: which clouds are pruned, and to how many points."""

import numpy as np
import pytest

from graphgs.errors import DataError
from graphgs.points import DenseCloud, PointsConfig, initial_points
from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction


class Events(Reporter):
    def __init__(self):
        self.events = []

    def event(self, kind, **fields):
        self.events.append((kind, fields))


def _reconstruction(count: int) -> Reconstruction:
    rng = np.random.default_rng(0)
    return Reconstruction(
        cameras=(Camera.pinhole(8, 8, 8, 8, 4, 4),),
        names=("a.jpg", "b.jpg"),
        camera_ids=np.zeros(2, int),
        rotations=np.tile(np.eye(3), (2, 1, 1)),
        translations=np.zeros((2, 3)),
        points=rng.normal(size=(count, 3)),
        colors=rng.integers(0, 256, (count, 3)).astype(np.uint8),
        errors=np.where(np.arange(count) % 7 == 0, -1.0, 0.5),  # -1: never measured
        track_offsets=2 * np.arange(count + 1),
        track_images=np.tile([0, 1], count).astype(np.int32),
        track_xy=np.zeros((2 * count, 2)),
    )


def _dense(count: int) -> DenseCloud:
    rng = np.random.default_rng(1)
    colors = rng.integers(0, 256, (count, 3)).astype(np.uint8)
    return DenseCloud(
        rng.normal(size=(count, 3)), colors, rng.integers(3, 6, count), np.zeros(count, int), np.full(count, 2.0)
    )


def _run(config: PointsConfig, count: int, *, dense: int = 0, max_splats: int = 10_000, reporter=None):
    return initial_points(
        config, _reconstruction(count), _dense(dense), max_splats=max_splats, reporter=reporter or Reporter(), threads=1
    )


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        (PointsConfig(), 1000),  # small clouds are kept whole
        (PointsConfig(minimum=300), 400),
        (PointsConfig(minimum=700), 700),
        (PointsConfig(target=123), 123),
        (PointsConfig(mode="none", target=123), 1000),
        (PointsConfig(tau=0.0), 1000),
    ],
)
def test_how_many_points_are_kept(config, expected):
    points = _run(config, 1000)
    assert len(points.positions) == expected
    assert points.representative.shape == (1000,)
    assert points.colors.dtype == np.uint8


@pytest.mark.parametrize(
    ("config", "max_splats", "expected"),
    [
        (PointsConfig(), 10_000, 6000),  # of 1000 reconstructed and 5000 dense points
        (PointsConfig(), 5_000, 3000),
        (PointsConfig(), 1_500, 1000),  # what is reconstructed stays
        (PointsConfig(), 1_000, 900),  # but for some room
        (PointsConfig(most_fraction=0.1, fill_fraction=0.1), 1_000, 100),
        (PointsConfig(minimum=900), 10_000, 900),
        (PointsConfig(target=2000), 10_000, 2000),
        (PointsConfig(mode="none"), 5_000, 3000),
        (PointsConfig(mode="none"), 1_000, 1000),  # what is reconstructed stays
        (PointsConfig(mode="none"), 100_000, 6000),
        (PointsConfig(tau=0.0), 100_000, 6000),
    ],
)
def test_dense_points_fill_up(config, max_splats, expected):
    points = _run(config, 1000, dense=5000, max_splats=max_splats)
    assert len(points.positions) == expected


def test_reconstructed_points_stay_and_the_octree_keeps_its_share_of_the_dense_ones():
    reporter = Events()
    points = _run(PointsConfig(target=800, fraction=0.4), 500, dense=5000, reporter=reporter)
    assert len(points.positions) == 800
    assert reporter.events[0][1]["dense"] == 750  # 300 are 40 % of them
    reconstructed = _reconstruction(500)
    stays = points.representative[:500]
    assert len(np.unique(stays)) == 500
    assert np.allclose(points.positions[stays], reconstructed.points)
    assert set(points.representative) == set(range(800))
    assert points.coverage > 0


def test_a_lone_far_point_is_no_wall():
    """Sizes are limited by a coarse cell, with dense points or without."""
    for dense in (0, 500):
        reconstruction = _reconstruction(300)
        reconstruction.points[7] = [0.0, 0.0, 60.0]
        points = initial_points(
            PointsConfig(), reconstruction, _dense(dense), max_splats=1000, reporter=Reporter(), threads=1
        )
        lone = points.representative[7]
        neighbour = np.sort(np.linalg.norm(points.positions - points.positions[lone], axis=1))[1]
        assert points.scales[lone] < 0.7 * neighbour


def test_a_cloud_without_points_is_explained():
    with pytest.raises(DataError, match="no 3D points") as caught:
        _run(PointsConfig(), 0)
    assert caught.value.hint


def test_what_happened_is_reported():
    reporter = Events()
    _run(PointsConfig(target=50), 200, reporter=reporter)
    (kind, fields), *_ = reporter.events
    assert (kind, fields["reconstructed"], fields["kept"]) == ("points", 200, 50)
    assert fields["coverage"] > 0


def test_wrong_settings_are_named():
    with pytest.raises(ValueError, match="fraction"):
        PointsConfig(fraction=0.0)
    with pytest.raises(ValueError, match="got both"):
        PointsConfig(target=5, tau=0.1)
