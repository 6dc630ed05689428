"""The ray caster against trying every triangle, and textures the right way round."""

import numpy as np

from graphgs.kernels.raycast import raycast
from graphgs.synth.mesh import MeshBuilder
from tests.support.reference.raycast import depth_image

K = np.array([[40.0, 0.0, 24.0], [0.0, 42.0, 16.0], [0.0, 0.0, 1.0]])


def _plain(value: int) -> np.ndarray:
    return np.full((8, 8, 3), value, np.uint8)


def _viewmat(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    viewmat = np.eye(4)
    q, _ = np.linalg.qr(np.eye(3) + 0.2 * rng.normal(size=(3, 3)))
    viewmat[:3, :3] = q * np.sign(np.diag(q))
    viewmat[:3, 3] = rng.normal(size=3) * 0.3 + [0, 0, 1]
    return viewmat


def test_depth_equals_every_triangle_tried(device):
    rng = np.random.default_rng(0)
    builder = MeshBuilder()
    for _ in range(25):
        corners = rng.uniform([-3, -2, 2], [3, 2, 8], (3, 3))
        builder.add_polygon(corners, np.array([[0, 0], [8, 0], [8, 8.0]]), _plain(100))
    scene = builder.build(device=device)
    for seed in range(3):
        viewmat = _viewmat(seed)
        _, depth = raycast(scene, viewmat, K, 48, 32, samples=1)
        expected, face = depth_image(np.concatenate(builder.vertices), np.array(builder.triangles), viewmat, K, 48, 32)
        agree = np.isclose(depth, expected, rtol=1e-4)
        assert 0.3 < (face >= 0).mean() < 1.0
        assert agree.mean() > 0.997  # float32 may fall on the other side of a triangle's rim


def test_texture_is_not_mirrored_and_pixels_match_texels(device):
    rows, columns = np.mgrid[:32, :48]
    texture = np.stack([5 * columns, 7 * rows, 2 * (columns + rows)], axis=-1).astype(np.uint8)
    z = 5.0
    left, right = (np.array([0, 48]) - K[0, 2]) / K[0, 0] * z
    top, bottom = (np.array([0, 32]) - K[1, 2]) / K[1, 1] * z
    builder = MeshBuilder()
    builder.add_quad(np.array([[left, top, z], [right, top, z], [right, bottom, z], [left, bottom, z]]), texture)
    scene = builder.build(device=device)
    image, depth = raycast(scene, np.eye(4), K, 48, 32, samples=1)
    np.testing.assert_allclose(depth, z, rtol=1e-5)
    # One texel per pixel, so the image is the lit texture: ramps survive the filter but for its clamping at the rim.
    inner = np.s_[3:-3, 3:-3]
    assert np.abs(image[inner].astype(int) - builder.images[0][inner]).max() <= 2


def test_edges_are_averaged_and_threads_change_nothing(device):
    builder = MeshBuilder()
    near = np.array([[-1, -1, 3], [0.31, -1, 3], [0.31, 1, 3], [-1, 1, 3.0]])
    builder.add_quad(near, _plain(0))
    builder.add_quad(near * 4 + [4, 0, 0], _plain(250))
    scene = builder.build(device=device)
    one, _ = raycast(scene, np.eye(4), K, 48, 32, samples=1)
    four, _ = raycast(scene, np.eye(4), K, 48, 32, samples=4)
    again, _ = raycast(scene, np.eye(4), K, 48, 32, samples=4, threads=2)
    column = int(0.31 / 3 * K[0, 0] + K[0, 2])
    assert one[16, column].max() in (0, one[16, column + 1].max())  # one ray sees one of both
    assert 0 < four[16, column].max() < four[16, column + 1].max()
    np.testing.assert_array_equal(four, again)


def test_sky_has_no_depth_and_gain_scales(device):
    builder = MeshBuilder()
    builder.add_quad(np.array([[-9, 0.5, 3], [9, 0.5, 3], [9, 9, 3], [-9, 9, 3.0]]), _plain(100))
    scene = builder.build(device=device)
    image, depth = raycast(scene, np.eye(4), K, 48, 32)
    assert (depth[:16] == 0).all()
    assert (depth[24:] > 0).all()
    brighter, _ = raycast(scene, np.eye(4), K, 48, 32, gain=1.5)
    np.testing.assert_allclose(brighter[26:], 1.5 * image[26:].astype(float), atol=1.5)
