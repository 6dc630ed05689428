"""What the scoreboard of shapes measures, on reconstructions whose faults are known."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.shape_measures import bowl, focal_error, measure, relative_rotations, share_near
from bench.shape_truth import Truth
from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import Similarity

UP = np.array([0.0, 0.0, 1.0])
ANYWHERE = Similarity(
    0.37, Rotation.from_euler("xyz", [20, -70, 130], degrees=True).as_matrix(), np.array([5, -3, 9.0])
)


def model_of(centers: np.ndarray, rotations: np.ndarray | None = None, *, focal: float = 800.0) -> Reconstruction:
    n = len(centers)
    rotations = Rotation.random(n, random_state=0).as_matrix() if rotations is None else rotations
    return Reconstruction(
        cameras=(Camera.pinhole(1000, 600, focal, focal, 500, 300),),
        names=tuple(f"{k:03d}.png" for k in range(n)),
        camera_ids=np.zeros(n, np.int64),
        rotations=rotations,
        translations=-np.einsum("nij,nj->ni", rotations, centers),
    )


def truth_of(model: Reconstruction, *, up: np.ndarray | None = None) -> Truth:
    return Truth(model.names, model.centers, model.rotations, np.full(len(model.names), 0.8), up)


@pytest.fixture
def grid() -> np.ndarray:
    """[99, 3] a flight of 200 x 160 m at 60 m."""
    x, y = np.meshgrid(np.linspace(-100, 100, 11), np.linspace(-80, 80, 9))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 60.0)])


@pytest.fixture
def drive() -> np.ndarray:
    """[80, 3] a bend, a photo a metre."""
    heading = np.linspace(0, 1.5, 80)
    return np.cumsum(np.column_stack([np.cos(heading), np.sin(heading), np.zeros(80)]), axis=0)


def test_a_similarity_is_no_error(grid):
    model = model_of(grid)
    found = measure(model.transformed(ANYWHERE), truth_of(model, up=UP))
    assert (found.photos, found.placed) == (99, 99)
    figures = [found.position_largest, found.rotation_p99, found.focal, found.local_scale, found.bend, found.scatter]
    np.testing.assert_allclose(figures, 0, atol=1e-4)


def test_position_errors_are_in_percent_of_the_diameter_and_one_outlier_moves_no_other(grid):
    model = model_of(grid)
    wrong = grid.copy()
    wrong[17, 2] += 25.0
    found = measure(model_of(wrong, model.rotations), truth_of(model))
    size = np.hypot(200, 160)
    assert found.diameter == pytest.approx(size)
    assert found.position_largest == pytest.approx(100 * 25 / size, rel=1e-6)
    assert found.position_median == pytest.approx(0, abs=1e-9)


def test_photos_that_are_missing_are_counted(grid):
    model = model_of(grid)
    part = dataclasses.replace(
        model, names=model.names[:40], rotations=model.rotations[:40], translations=model.translations[:40],
        camera_ids=model.camera_ids[:40],
    )  # fmt: skip
    found = measure(part, truth_of(model))
    assert (found.placed, found.photos) == (40, 99)
    assert found.position_largest == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("bend", [14.5, -3.0])
def test_a_bowl_is_measured_from_its_middle_to_its_rim(grid, bend):
    squared = (grid[:, :2] ** 2).sum(1)
    noise = np.random.default_rng(0).normal(0, 0.5, len(grid))
    bent = grid + UP * (bend * squared / squared.max() + 0.02 * grid[:, 0] + 7.0 + noise)[:, None]
    found, scatter = bowl(grid, bent - grid, UP)
    assert found == pytest.approx(bend, abs=0.5)
    assert scatter == pytest.approx(0.5, rel=0.2)
    model = model_of(grid)  # whatever the alignment makes of it
    found = measure(model_of(bent).transformed(ANYWHERE), truth_of(model, up=UP))
    assert found.bend == pytest.approx(bend, abs=0.8)
    assert found.scatter == pytest.approx(0.5, rel=0.3)


def test_a_stretch_of_another_scale_is_found(drive):
    step = np.diff(drive, axis=0, prepend=drive[:1])
    step[:20] *= 1.8
    model = model_of(drive)
    found = measure(model_of(np.cumsum(step, axis=0), model.rotations), truth_of(model))
    assert found.local_scale == pytest.approx(80, abs=3)
    step[:20] /= 1.8**2
    found = measure(model_of(np.cumsum(step, axis=0), model.rotations), truth_of(model))
    assert found.local_scale == pytest.approx(100 / 1.8 - 100, abs=3)


def test_one_turned_photo_of_many_shows_in_the_99th_percentile():
    rotations = Rotation.random(50, random_state=1).as_matrix()
    wrong = rotations.copy()
    wrong[3] = Rotation.from_euler("y", 4.0, degrees=True).as_matrix() @ wrong[3]
    turned = relative_rotations(wrong @ ANYWHERE.rotation, rotations)
    assert len(turned) == 50 * 49 // 2
    assert np.median(turned) == pytest.approx(0, abs=1e-5)
    assert np.percentile(turned, 99) == pytest.approx(4.0, abs=1e-5)


def test_the_focal_length_is_compared_in_picture_widths(grid):
    found = model_of(grid, focal=820.0)
    assert focal_error(found, np.arange(3), np.full(3, 0.8)) == pytest.approx(2.5)
    assert focal_error(found, np.arange(3), np.array([0.8, 0.9, 0.82])) == pytest.approx(100 * (0.82 / 0.9 - 1))


def test_the_share_of_points_near_lidar():
    lidar = np.array([[0.0, 0, 0], [10, 0, 0]])
    points = np.array([[0.29, 0, 0], [0, 0.31, 0], [10, 0, -0.1], [50, 0, 0]])
    assert share_near(points, lidar) == 50.0
    assert share_near(np.zeros((0, 3)), lidar) == 0.0
