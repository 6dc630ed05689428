"""The image comparison by rows against the plain shape, in float32."""

import numpy as np
import pytest
import warp as wp

from graphgs.kernels.launch import launch_range
from graphgs.kernels.ssim import pixels, rows

HEIGHT, WIDTH, CAMERAS = 11, 170, 2


@pytest.fixture
def operands():
    generator = np.random.default_rng(0)
    count = CAMERAS * HEIGHT * WIDTH * 3
    a = generator.random(count, dtype=np.float32)
    b = np.clip(a + 0.1 * generator.standard_normal(count, dtype=np.float32), 0, 1)
    kept = np.repeat(generator.random(count // 3) > 0.2, 3).astype(np.float32)
    a = np.where(kept == 1, a, b)
    b[:30] = a[:30]  # |a - b| has its corner there
    return [wp.array(x, dtype=float, device="cpu") for x in (a, b, kept)]


def outputs(*counts, dtype=float):  # poisoned: what a kernel forgets to write shows
    return [wp.full(count, float("inf"), dtype=dtype, device="cpu") for count in counts]


def test_rows_agree_with_pixels(operands):
    count = operands[0].shape[0]
    inputs = [*operands, HEIGHT, WIDTH]
    slopes_rows, slopes_pixels, errors, similarities = outputs(3 * count, 3 * count, count, count)
    (row_sums,) = outputs(2 * CAMERAS * HEIGHT, dtype=wp.float64)
    launch_range(rows.compare_rows, CAMERAS * HEIGHT, inputs=inputs, outputs=[slopes_rows, row_sums], device="cpu")
    launch_range(
        pixels.compare_pixels, count, inputs=inputs, outputs=[slopes_pixels, errors, similarities], device="cpu"
    )
    # single derivatives grow large where the variance is near 0, so compare in the norm
    difference = np.linalg.norm(slopes_rows.numpy() - slopes_pixels.numpy())
    assert difference < 1e-4 * np.linalg.norm(slopes_pixels.numpy())
    sums = [x.numpy().reshape(CAMERAS * HEIGHT, -1).sum(axis=1) for x in (errors, similarities)]
    np.testing.assert_allclose(row_sums.numpy().reshape(2, -1), sums, rtol=1e-5, atol=1e-4)

    v_sums = wp.array([0.7, -0.4], dtype=float, device="cpu")
    v_rows, v_pixels = outputs(count, count)
    gradient_inputs = [*inputs, slopes_pixels, v_sums]
    launch_range(rows.compare_rows_gradient, CAMERAS * HEIGHT, inputs=gradient_inputs, outputs=[v_rows], device="cpu")
    launch_range(pixels.compare_pixels_gradient, count, inputs=gradient_inputs, outputs=[v_pixels], device="cpu")
    difference = np.linalg.norm(v_rows.numpy() - v_pixels.numpy())
    assert difference < 1e-5 * np.linalg.norm(v_pixels.numpy())
    assert np.all(v_rows.numpy()[operands[2].numpy() == 0] == 0)
