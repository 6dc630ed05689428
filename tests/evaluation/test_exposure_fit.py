"""The second figure: exposure fitted on the left half, scored on the right half alone."""

import math

import numpy as np
import pytest

from graphgs.evaluation.exposure_fit import psnr_exposure_fitted
from graphgs.evaluation.metrics import psnr

HEIGHT, WIDTH = 20, 31  # odd: the middle column belongs to one half only


@pytest.fixture
def truth():
    return np.random.default_rng(0).integers(60, 200, (HEIGHT, WIDTH, 3)).astype(np.uint8)


def darker(truth: np.ndarray) -> np.ndarray:
    """The photo under another exposure and white balance."""
    mixed = truth / 255.0 @ np.array([[0.7, 0.05, 0.0], [0.0, 0.6, 0.1], [0.02, 0.0, 0.8]]) + [0.05, 0.0, 0.02]
    return mixed.astype(np.float32)


def test_an_affine_difference_is_forgiven(truth):
    render = darker(truth)
    assert psnr(render, truth) < 20
    assert psnr_exposure_fitted(render, truth) > 100  # float32 of the render alone is left


def test_only_the_right_half_is_scored_and_only_the_left_is_fitted(truth):
    half = WIDTH // 2
    render = darker(truth)
    render[:, half:] += 0.1  # the fit cannot know: 20 dB away
    assert psnr_exposure_fitted(render, truth) < 21
    noisy = truth / 255.0
    noisy[:, :half] += np.random.default_rng(1).normal(0, 0.1, (HEIGHT, half, 3))
    score = psnr_exposure_fitted(np.clip(noisy, 0, 1).astype(np.float32), truth)
    assert score > psnr(np.clip(noisy, 0, 1), truth)  # noise on the left enters through 12 numbers only
    assert score < 100


def test_a_grey_photo_has_an_answer(truth):
    grey = truth[..., :1].repeat(3, axis=-1)
    assert psnr_exposure_fitted((0.7 * (grey / 255.0) + 0.1).astype(np.float32), grey) > 100
    black = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    assert math.isfinite(psnr_exposure_fitted(black, truth))


def test_masked_pixels_take_no_part(truth):
    render = darker(truth)
    mask = np.ones((HEIGHT, WIDTH), dtype=bool)
    mask[:5] = False
    render[:5] = 1.0
    assert psnr_exposure_fitted(render, truth, mask) > 100
    for half in (slice(None, WIDTH // 2), slice(WIDTH // 2, None)):
        mask = np.ones((HEIGHT, WIDTH), dtype=bool)
        mask[:, half] = False
        assert math.isnan(psnr_exposure_fitted(render, truth, mask))
