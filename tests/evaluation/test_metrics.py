"""PSNR by its definition, SSIM against scikit-image."""

import math

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from graphgs.evaluation import psnr
from graphgs.evaluation import ssim as ssim_metric


@pytest.fixture
def pair():
    generator = np.random.default_rng(3)
    smooth = np.linspace(0, 1, 41)[:, None, None] * np.linspace(0.2, 1, 57)[None, :, None] * np.ones(3)
    truth = np.round(255 * np.clip(smooth + 0.1 * generator.standard_normal((41, 57, 3)), 0, 1)).astype(np.uint8)
    render = (truth / 255 + 0.08 * generator.standard_normal(truth.shape)).astype(np.float32)
    return render, truth


def test_psnr_is_that_of_the_clamped_render_against_the_8_bit_truth(pair):
    render, truth = pair
    expected = -10 * math.log10(np.mean((np.clip(render.astype(float), 0, 1) - truth / 255) ** 2))
    assert psnr(render, truth) == pytest.approx(expected, abs=1e-12)
    assert psnr(torch.tensor(render, requires_grad=True), torch.tensor(truth)) == psnr(render, truth)


def test_psnr_of_a_known_error():
    truth = np.full((4, 4, 3), 102, dtype=np.uint8)  # 0.4
    assert psnr(np.full((4, 4, 3), 0.5), truth) == pytest.approx(20.0, abs=1e-9)
    assert psnr(truth, truth) == math.inf


def test_ssim_equals_scikit_image(pair):
    render, truth = pair
    clamped = np.clip(render.astype(float), 0, 1)
    expected = structural_similarity(
        clamped,
        truth / 255,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1,
        channel_axis=-1,
    )
    assert ssim_metric(render, truth) == pytest.approx(expected, abs=1e-10)
    assert ssim_metric(torch.tensor(render), torch.tensor(truth)) == ssim_metric(render, truth)
    batch = np.stack([render, render]), np.stack([truth, truth])
    assert ssim_metric(*batch) == pytest.approx(expected, abs=1e-10)


def test_masked_pixels_do_not_count(pair):
    render, truth = pair
    mask = np.ones(render.shape[:2], dtype=np.uint8)
    mask[10:20, 30:50] = 0
    spoiled = np.where(mask[..., None] == 0, 1.0 - render, render)
    for metric in (psnr, ssim_metric):
        assert metric(spoiled, truth, mask) == metric(render, truth, mask[..., None])
        assert metric(spoiled, truth, mask) != metric(spoiled, truth)
        assert math.isnan(metric(render, truth, np.zeros_like(mask)))


@pytest.mark.parametrize("metric", [psnr, ssim_metric])
def test_wrong_arguments_are_named(metric, pair):
    render, truth = pair
    with pytest.raises(ValueError, match=r"expected two \[..., H, W, 3\]"):
        metric(render, truth[:-1])
    with pytest.raises(ValueError, match=r"mask: expected \[41, 57\]"):
        metric(render, truth, np.ones((3, 3)))


def test_ssim_needs_a_whole_window():
    with pytest.raises(ValueError, match="at least 11 x 11 px, got 30 x 10"):
        ssim_metric(np.zeros((10, 30, 3)), np.zeros((10, 30, 3)))
