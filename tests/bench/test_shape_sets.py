"""The synthetic drives and flights of the scoreboard of shapes: their truth, their lens, what they can tell."""

import dataclasses

import numpy as np
import pytest
from PIL import Image

from bench.flights import FlightConfig, true_model, write_flight
from bench.lens import Lens, distorted, undistorted
from bench.shape_information import focal_deviation
from bench.shape_synthetic import KINDS, RELIEF, synthetic_set
from bench.shape_verdict import FOCAL_LIMIT
from graphgs.scene.camera import Camera
from graphgs.scene.colmap import read_model
from graphgs.scene.similarity import Similarity
from graphgs.sources.exif import read_exif
from graphgs.synth import StreetConfig, write_street

BARREL = Camera("SIMPLE_RADIAL", 64, 48, (45.0, 32.0, 24.0, -0.05))
SMALL = {"strips": 2, "per_strip": 2, "width": 160, "height": 120}


@pytest.fixture(scope="module")
def hills(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hills")
    return folder, write_flight(FlightConfig(relief=RELIEF, **SMALL), folder)


def test_a_lens_and_its_inverse():
    xy = np.random.default_rng(0).uniform(-0.75, 0.75, (100, 2))
    np.testing.assert_allclose(distorted(undistorted(xy, BARREL), BARREL), xy, atol=1e-12)
    far = np.array([0.7, 0.5])
    np.testing.assert_allclose(distorted(far, BARREL), far * (1 - 0.05 * 0.74))


def test_a_dot_appears_where_the_lens_bends_it():
    lens = Lens(BARREL)
    fx, fy, cx, cy = lens.pinhole.focal_and_center
    rays = np.array([[-0.6, -0.4], [0.55, 0.3], [0.0, 0.45]])
    picture = np.zeros((lens.pinhole.height, lens.pinhole.width, 3), np.uint8)
    rows, columns = np.mgrid[: lens.pinhole.height, : lens.pinhole.width] + 0.5
    for x, y in rays * [fx, fy] + [cx, cy]:
        picture += (250 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 8)).astype(np.uint8)[..., None]
    photo = lens.photograph(picture)[..., 0].astype(float)
    rows, columns = np.mgrid[: BARREL.height, : BARREL.width] + 0.5
    for ray in rays:
        want = distorted(ray, BARREL) * 45.0 + [32.0, 24.0]
        near = photo * (np.hypot(columns - want[0], rows - want[1]) < 6)
        found = np.array([(near * columns).sum(), (near * rows).sum()]) / near.sum()
        np.testing.assert_allclose(found, want, atol=0.05)


def test_the_photos_of_a_flight_show_the_same_ground_where_the_truth_says(hills):
    """Grey values around true points agree between photos, better than around their places without the distortion."""
    folder, truth = hills
    photos = np.stack([np.asarray(Image.open(folder / "images" / name).convert("L"), float) for name in truth.names])
    camera = truth.cameras[0]
    unbent = undistorted((truth.track_xy - [80, 60]) / camera.params[0], camera) * camera.params[0] + [80, 60]

    def differences(places: np.ndarray) -> np.ndarray:
        """Between two photos of one point, [n]."""
        inside = np.clip(places, 0.5, [159.4, 119.4])
        columns, rows = np.floor(inside).astype(int).T
        grey = photos[truth.track_images, rows, columns]
        first = truth.track_offsets[:-1]
        return np.abs(grey[first] - grey[first + 1])

    right, shuffled = differences(truth.track_xy), np.abs(np.diff(np.random.default_rng(0).permutation(photos.ravel())))
    assert np.median(right) < 0.4 * np.median(shuffled)
    assert right.mean() < 0.9 * differences(unbent).mean()


def test_truth_and_exif_of_a_flight(hills):
    folder, truth = hills
    model = read_model(folder / "truth")
    assert model.names == truth.names == ("000.jpg", "001.jpg", "002.jpg", "003.jpg")
    np.testing.assert_allclose(model.centers, truth.centers, atol=1e-9)
    np.testing.assert_allclose(-model.centers[:, 1], 60.0, atol=2.0)  # y points down
    np.testing.assert_allclose(model.rotations[:, 2, 1], 1.0, atol=0.01)  # all look down
    assert np.ptp(model.points[:, 1]) > 0.5 * RELIEF
    with Image.open(folder / "images" / "000.jpg") as photo:
        said = read_exif(photo).focal_px(160, 120)
    assert 0.02 <= abs(model.cameras[0].params[0] / said - 1) <= 0.03
    assert -0.05 <= model.cameras[0].distortion[0] <= -0.02


def test_points_of_a_flight_lie_on_its_ground(hills):
    _, truth = hills
    terrain = FlightConfig(relief=RELIEF, **SMALL).terrain
    x, y, z = truth.points.T
    np.testing.assert_allclose(-y, terrain.height(x, z))
    flat = FlightConfig(relief=0.0, **SMALL).terrain
    assert np.abs(flat.height(x, z)).max() == 0.0


@pytest.mark.parametrize("kind", ["bend-wide", "corner-narrow", "straight-wide"])
def test_the_photos_of_a_drive_tell_as_much_as_is_said(kind, tmp_path):
    """The whole drive in tiny pictures, which change nothing of its geometry but the noise: half a pixel of the large
    ones is kept."""
    config = dataclasses.replace(
        KINDS[kind].config(0), width=64, height=36, samples=1, texels_per_m=16.0, points=2000, noise=0.0
    )
    truth = write_street(config, tmp_path).reconstruction
    deviation = focal_deviation(_enlarged(truth, 640, 360))
    assert KINDS[kind].determined == (3 * deviation < FOCAL_LIMIT)
    if kind.startswith("straight"):
        assert deviation == np.inf


def test_hills_tell_the_focal_length_and_a_plane_does_not():
    deviations = {}
    for kind in ("flight-flat", "flight-hilly"):
        config = KINDS[kind].config(0)
        deviations[kind] = focal_deviation(true_model(config))
        assert KINDS[kind].determined == (3 * deviations[kind] < FOCAL_LIMIT)
    assert deviations["flight-flat"] > 3 * deviations["flight-hilly"]


def test_the_bound_does_not_depend_on_the_world_or_on_which_photo_comes_first():
    truth = true_model(FlightConfig(relief=RELIEF, strips=2, per_strip=4))
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    moved = truth.transformed(Similarity(3.0, turn, np.array([5.0, -2, 9])))
    assert focal_deviation(moved) == pytest.approx(focal_deviation(truth), rel=1e-6)


def test_a_drive_is_made_once_and_has_its_truth(tmp_path, monkeypatch):
    small = StreetConfig(frames=3, width=96, height=54, texels_per_m=16.0, points=300, depth=False, course="straight")
    monkeypatch.setitem(KINDS, "tiny", dataclasses.replace(KINDS["straight-wide"], config=lambda seed: small))
    found = synthetic_set(tmp_path, "tiny", 0)
    assert found.name == "tiny-0"
    assert found.photos == found.truth.names == tuple(f"{k:06d}.jpg" for k in (1, 2, 3))
    assert found.determined is False
    assert found.truth.up is None
    before = (found.images / "000001.jpg").stat().st_mtime_ns
    assert (synthetic_set(tmp_path, "tiny", 0).images / "000001.jpg").stat().st_mtime_ns == before


def _enlarged(truth, width: int, height: int):
    camera = truth.cameras[0]
    scale = [width / camera.width, height / camera.height]
    return dataclasses.replace(
        truth, cameras=tuple(c.scaled_to(width, height) for c in truth.cameras), track_xy=truth.track_xy * scale
    )
