"""The comparison of images by blocks of threads, against the plain shape in float64."""

import numpy as np
import pytest
import warp as wp

from graphgs.kernels.ssim import ImagePair, compare_images, compare_images_gradient

# images, height, width: one pixel; smaller than the window; one tile exactly; rims of every kind
SIZES = [(1, 1, 1), (1, 3, 4), (1, 16, 16), (2, 17, 33), (1, 40, 50)]


def image_pair(shape, dtype, device):
    images, height, width = shape
    generator = np.random.default_rng(0)
    a = generator.random((images, height, width, 3))
    b = np.clip(a + 0.1 * generator.standard_normal(a.shape), 0, 1)
    b[:, : height // 4] = a[:, : height // 4]  # |a - b| has its corner there
    kept = np.broadcast_to(generator.random((images, height, width, 1)) > 0.2, a.shape)
    a = np.where(kept, a, b)
    arrays = [wp.array(x.reshape(-1), dtype=dtype, device=device) for x in (a, b, kept.astype(np.float64))]
    return ImagePair(*arrays, height=height, width=width)


def compare(images, v_sums, **options):
    """Slopes, the two sums, and the gradient from the plain shape's slopes; poisoned, so that a gap shows."""
    dtype, device, count = images.a.dtype, images.a.device, images.a.shape[0]
    slopes, v_a = (wp.full(n, float("inf"), dtype=dtype, device=device) for n in (3 * count, count))
    sums = wp.full(2, float("inf"), dtype=wp.float64, device=device)
    compare_images(images, slopes, sums, **options)
    v_sums = wp.array(v_sums, dtype=dtype, device=device)
    compare_images_gradient(images, slopes, v_sums, v_a, **options)
    return [x.numpy().astype(np.float64) for x in (slopes, sums, v_a)]


@pytest.mark.usefixtures("cpu_blocks")
@pytest.mark.parametrize("shape", SIZES)
def test_blocks_agree_with_the_plain_shape(shape, device):
    images = image_pair(shape, wp.float32, device)
    slopes, sums, v_a = compare(images, [0.7, -0.4], shape="blocks")
    expected = compare(image_pair(shape, wp.float64, device), [0.7, -0.4])
    # float32: variances are differences of numbers near 0.3, rounded at 1e-7, beside C2 = 9e-4
    assert np.linalg.norm(slopes - expected[0]) <= 1e-4 * np.linalg.norm(expected[0])
    assert sums == pytest.approx(expected[1], rel=1e-5)
    assert np.linalg.norm(v_a - expected[2]) <= 1e-4 * np.linalg.norm(expected[2])
    assert np.all(v_a[images.kept.numpy() == 0] == 0)


@pytest.mark.usefixtures("cpu_blocks")
def test_blocks_give_the_same_bits_every_time(device):
    images = image_pair((1, 40, 50), wp.float32, device)
    runs = [compare(images, [1.0, -1.0], shape="blocks") for _ in range(2)]
    assert all(np.array_equal(x, y) for x, y in zip(*runs, strict=True))


def test_blocks_refuse_a_cpu_that_would_run_one_thread_of_each():
    assert not wp.config.enable_cpu_blocks
    images = image_pair((1, 3, 4), wp.float32, "cpu")
    with pytest.raises(RuntimeError, match="compare_blocks: a kernel of blocks runs on the CPU"):
        compare(images, [1.0, 1.0], shape="blocks")


@pytest.mark.parametrize(("dtype", "shape"), [(wp.float32, "rows"), (wp.float64, "pixels")])
def test_the_cpu_keeps_its_own_shapes(dtype, shape):
    assert image_pair((1, 3, 4), dtype, "cpu").shape == shape
