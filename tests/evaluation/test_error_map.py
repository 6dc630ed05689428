"""Error pictures: a fixed scale, readable in grey."""

import numpy as np

from graphgs.evaluation.error_map import IGNORED, color_stops, error_map


def luminance(rgb: np.ndarray) -> np.ndarray:
    return rgb @ np.array([0.2126, 0.7152, 0.0722])


def test_brightness_grows_with_the_error_on_a_fixed_scale():
    truth = np.zeros((1, 6, 3), np.uint8)
    render = np.repeat(np.array([[0.0, 0.05, 0.1, 0.2, 0.25, 0.9]], np.float32)[..., None], 3, axis=2)
    colors = error_map(truth, render)
    light = luminance(colors[0].astype(float))
    assert light[0] < 5
    assert (np.diff(light[:5]) > 10).all()
    np.testing.assert_array_equal(colors[0, 4], colors[0, 5])
    alone = error_map(truth[:, :2], render[:, :2])  # the scale does not depend on the picture
    np.testing.assert_array_equal(alone, colors[:, :2])


def test_masked_and_broken_pixels_are_told_apart():
    truth, render = np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2, 3), np.float32)
    render[0, 0] = np.nan
    colors = error_map(truth, render, np.array([[True, True], [False, True]]))
    assert tuple(colors[1, 0]) == IGNORED
    assert tuple(colors[0, 0]) == color_stops(2)[-1]
    assert tuple(colors[1, 1]) == color_stops(2)[0]
