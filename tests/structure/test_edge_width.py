"""Blur by itself: of steps it is known of, of photos that are sharp, and of the same blurred."""

import cv2
import numpy as np
import pytest

from graphgs.structure.edge_width import BLURRED_PX, edge_width
from graphgs.structure.sharpness import SIDE, measure_sharpness
from tests.support.hard_scenes import house_row, turn_on_the_spot

SETS = [
    "castle", "fountain", "fox", "kitti_street", "kitti_bend", "kitti_rig", "lund_street", "ochota_aerial",
    "seneca_aerial",
]  # fmt: skip


def squares(sigma: float, *, contrast: float = 120.0, noise: float = 0.0, shape=(400, 600)) -> np.ndarray:
    """Bright squares on a dark ground, blurred by a known amount."""
    rng = np.random.default_rng(0)
    image = np.zeros(shape, np.float32)
    for y in range(30, shape[0] - 60, 70):
        for x in range(30, shape[1] - 60, 70):
            image[y : y + 35, x : x + 35] = 1.0
    if sigma:
        image = cv2.GaussianBlur(image, (0, 0), sigma)
    return np.clip(60 + contrast * image + rng.normal(0, noise, shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("sigma", [1.0, 2.0, 3.0, 4.0])
def test_the_width_of_a_step_is_found(sigma):
    # Pixels have a width of their own: half a pixel is not told apart from a sharp edge.
    assert edge_width(squares(sigma)) == pytest.approx(2.563 * sigma, rel=0.1, abs=0.6)


def test_contrast_and_noise_change_little():
    assert edge_width(squares(3.0, contrast=30)) == pytest.approx(7.7, rel=0.15)
    assert edge_width(squares(3.0, noise=3)) == pytest.approx(7.7, rel=0.25)


def test_a_shaken_photo_is_blurred_though_half_its_edges_are_sharp():
    assert edge_width(cv2.blur(squares(0.0), (1, 25))) > BLURRED_PX


def test_where_there_are_no_edges_nothing_is_said():
    assert np.isnan(edge_width(np.full((200, 300), 120, np.uint8)))
    noise = np.random.default_rng(0).normal(120, 2, (200, 300)).astype(np.uint8)
    assert not edge_width(noise) > BLURRED_PX


@pytest.mark.parametrize("shots", [house_row, turn_on_the_spot], ids=lambda f: f.__name__)
def test_rendered_photos_are_sharp_until_they_are_blurred(shots):
    for image in shots(count=3).images:
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        assert measure_sharpness(grey).edge_px < 0.6 * BLURRED_PX
        assert measure_sharpness(cv2.GaussianBlur(grey, (0, 0), 4)).edge_px > BLURRED_PX


@pytest.mark.parametrize("name", SETS)
def test_real_photos_are_sharp_until_they_are_blurred(shared_data, name):
    """Fog, darkness and coarse JPEG make no blur of them."""
    files = [
        f for f in sorted((shared_data(name) / "images").rglob("*")) if f.suffix.lower() in (".png", ".jpg", ".jpeg")
    ]
    for file in files[:: max(1, len(files) // 4)]:
        grey = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        scale = max(1.0, max(grey.shape) / SIDE)
        jpeg = cv2.imdecode(cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, 30])[1], cv2.IMREAD_GRAYSCALE)
        for sharp in (grey, (150 + grey / 5).astype(np.uint8), grey // 4, jpeg):
            assert not measure_sharpness(sharp).edge_px > 0.6 * BLURRED_PX, file.name
        assert measure_sharpness(cv2.GaussianBlur(grey, (0, 0), 4 * scale)).edge_px > BLURRED_PX, file.name
