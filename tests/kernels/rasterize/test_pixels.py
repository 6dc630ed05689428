"""The plain shape against a float64 loop over every splat and pixel."""

import numpy as np
import pytest
import warp as wp

from graphgs.kernels.rasterize.pixels import composite_pixels, composite_pixels_backward
from tests.support.splats import composite_by_kernels, composite_by_reference, make_splats

SCENES = {
    "plain": make_splats(40),
    "one channel, masked": make_splats(40, channels=1, masked=True, seed=1),
    "32 channels, two cameras": make_splats(30, 20, 9, channels=32, cameras=2, seed=2),
    "saturated, masked, two cameras": make_splats(90, 20, 18, opacity=(0.9, 1.0), masked=True, cameras=2, seed=3),
    "equal depths": make_splats(40, equal_depths=True, seed=4),
    "empty": make_splats(0),
    "one pixel": make_splats(12, 1, 1, seed=5),
}


@pytest.mark.parametrize("real", [wp.float64, wp.float32])
@pytest.mark.parametrize("name", SCENES)
def test_values_and_gradients_equal_the_reference(name, real, device):
    # float32 rounds at 6e-8; sums over pixels and light taken away splat by splat amplify that about 1000 times.
    tolerance = 1e-9 if real is wp.float64 else 1e-4
    scene = SCENES[name]
    expected = composite_by_reference(scene)
    got = composite_by_kernels(scene, composite_pixels, composite_pixels_backward, real=real, device=device)
    for got_part, expected_part in zip(got, expected, strict=True):
        for key, want in expected_part.items():
            distance = np.linalg.norm(got_part[key] - want)
            assert distance <= tolerance * max(np.linalg.norm(want), 1e-6), key


def test_a_masked_pixel_shows_the_background_alone():
    scene = SCENES["one channel, masked"]
    values, _ = composite_by_kernels(scene, composite_pixels, composite_pixels_backward)
    hidden = ~scene.masks
    assert hidden.any()
    assert (values["colors"][hidden] == scene.backgrounds.astype(np.float32)[0]).all()
    for name in ("alphas", "depths", "median_depths"):
        assert (values[name][hidden] == 0).all()


def test_median_depth_is_where_half_the_light_is_gone():
    """Two splats that take 0.4 each over one pixel: the second crosses one half, at its depth exactly."""
    scene = make_splats(2, 1, 1)
    scene.splats["means2d"][:] = 0.5
    scene.splats["opacities"][:] = 0.4
    scene.splats["depths"][:] = [[7.0, 3.0]]
    values, gradients = composite_by_kernels(scene, composite_pixels, composite_pixels_backward)
    assert values["median_depths"] == 7.0
    expected = composite_by_reference(scene)[1]["depths"]
    np.testing.assert_allclose(gradients["depths"], expected, rtol=1e-5)
    scene.splats["opacities"][:] = 0.2
    values, _ = composite_by_kernels(scene, composite_pixels, composite_pixels_backward)
    assert values["median_depths"] == 0


def test_what_is_not_wanted_changes_nothing():
    scene = make_splats(40)
    full = composite_by_kernels(scene, composite_pixels, composite_pixels_backward)
    scene.cotangents["median_depths"][:] = 0
    silent = composite_by_kernels(scene, composite_pixels, composite_pixels_backward)
    lean = composite_by_kernels(scene, composite_pixels, composite_pixels_backward, features=False)
    for key, value in lean[0].items():
        assert np.array_equal(value, full[0][key])
    for key, value in lean[1].items():
        assert np.array_equal(value, silent[1][key])
