"""The points stage: which clouds are pruned, and to how many points."""

import numpy as np
import pytest

from graphgs.errors import DataError
from graphgs.points import PointsConfig, initial_points
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


def _run(config: PointsConfig, count: int):
    return initial_points(config, _reconstruction(count), reporter=Reporter(), threads=1)


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


def test_a_cloud_without_points_is_explained():
    with pytest.raises(DataError, match="no 3D points") as caught:
        _run(PointsConfig(), 0)
    assert caught.value.hint


def test_what_happened_is_reported():
    reporter = Events()
    initial_points(PointsConfig(target=50), _reconstruction(200), reporter=reporter, threads=1)
    (kind, fields), *_ = reporter.events
    assert (kind, fields["reconstructed"], fields["kept"]) == ("points", 200, 50)
    assert fields["coverage"] > 0


def test_wrong_settings_are_named():
    with pytest.raises(ValueError, match="fraction"):
        PointsConfig(fraction=0.0)
    with pytest.raises(ValueError, match="got both"):
        PointsConfig(target=5, tau=0.1)
