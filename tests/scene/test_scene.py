"""Cameras, reconstructions, similarities, views: the shared types."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graphgs.scene.camera import MODEL_PARAMS, Camera
from graphgs.scene.names import inside
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import Similarity, align, align_robust, diameter
from graphgs.scene.views import ImageCache, Views


def test_camera_matrix_and_distortion_order():
    camera = Camera("SIMPLE_RADIAL", 640, 480, (500, 320, 240, 0.1))
    np.testing.assert_array_equal(camera.K, [[500, 0, 320], [0, 500, 240], [0, 0, 1]])
    np.testing.assert_array_equal(camera.distortion, [0.1, 0, 0, 0])
    full = Camera("FULL_OPENCV", 640, 480, (500, 501, 320, 240, 1, 2, 3, 4, 5, 6, 7, 8))
    np.testing.assert_array_equal(full.distortion, [1, 2, 3, 4, 5, 6, 7, 8])
    assert Camera("OPENCV_FISHEYE", 640, 480, (500, 501, 320, 240, 1, 2, 3, 4)).is_fisheye
    assert len(Camera.pinhole(640, 480, 500, 500, 320, 240).distortion) == 0


@pytest.mark.parametrize("model", MODEL_PARAMS)
def test_a_scaled_camera_sees_the_same_rays(model):
    params = [400.0, 320.0, 240.0] if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL") else [400.0, 410, 320, 240]
    params += [0.01] * (MODEL_PARAMS[model] - len(params))
    camera = Camera(model, 640, 480, tuple(params))
    half = camera.scaled_to(320, 240)
    ray = np.array([0.2, -0.1, 1.0])
    np.testing.assert_allclose((half.K @ ray)[:2], (camera.K @ ray)[:2] / 2)
    np.testing.assert_array_equal(half.distortion, camera.distortion)


@pytest.mark.parametrize(
    ("model", "size", "params"),
    [
        ("THING", (640, 480), (1.0,)),
        ("PINHOLE", (640, 480), (1.0, 1.0)),
        ("PINHOLE", (0, 480), (500.0, 500.0, 320.0, 240.0)),
        ("PINHOLE", (640, 480), (500.0, -500.0, 320.0, 240.0)),
        ("PINHOLE", (640, 480), (500.0, 500.0, float("nan"), 240.0)),
    ],
)
def test_impossible_cameras_are_refused(model, size, params):
    with pytest.raises(ValueError, match="expected"):
        Camera(model, *size, params)


def posed(n: int = 5) -> Reconstruction:
    rng = np.random.default_rng(3)
    return Reconstruction(
        (Camera.pinhole(np.int64(64), np.int64(48), np.float32(50), 50, 32, 24),),
        tuple(f"{i}.jpg" for i in range(n)),
        np.zeros(n, int),
        Rotation.random(n, random_state=3).as_matrix(),
        rng.normal(size=(n, 3)),
        points=rng.normal(size=(7, 3)),
        colors=np.zeros((7, 3), np.uint8),
        errors=np.ones(7),
        track_offsets=np.zeros(8, np.int64),
    )


def test_reconstruction_round_trip(tmp_path):
    original = posed()
    original.save(tmp_path / "r")
    back = Reconstruction.load(tmp_path / "r")
    assert back.names == original.names
    assert back.cameras == original.cameras
    np.testing.assert_array_equal(back.rotations, original.rotations)
    np.testing.assert_array_equal(back.points, original.points)
    assert back.track_lengths.tolist() == [0] * 7


def test_a_change_of_world_leaves_pixels_where_they_were():
    original = posed()
    change = Similarity(2.5, Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix(), np.array([1.0, 2.0, 3.0]))
    moved = original.transformed(change)

    def project(r):
        x = np.einsum("nij,pj->npi", r.viewmats, np.c_[r.points, np.ones(len(r.points))])[..., :3]
        return x[..., :2] / x[..., 2:]

    np.testing.assert_allclose(project(moved), project(original), rtol=1e-9)
    np.testing.assert_allclose(moved.centers, change.apply(original.centers))


def test_alignment_recovers_a_similarity():
    source = np.random.default_rng(0).normal(size=(20, 3))
    truth = Similarity(0.3, Rotation.from_rotvec([1.0, 2.0, -0.5]).as_matrix(), np.array([5.0, -1.0, 2.0]))
    found = align(source, truth.apply(source))
    np.testing.assert_allclose(found.apply(source), truth.apply(source), atol=1e-9)
    assert np.linalg.det(found.rotation) == pytest.approx(1)
    mirrored = align(source, source * [1, 1, -1])
    assert np.linalg.det(mirrored.rotation) == pytest.approx(1)  # a rotation, never a reflection


def test_robust_alignment_ignores_a_wrong_minority():
    rng = np.random.default_rng(0)
    source = rng.normal(size=(30, 3))
    truth = Similarity(2.0, Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix(), np.ones(3))
    target = truth.apply(source) + rng.normal(scale=1e-4, size=(30, 3))
    target[:9] += 100
    found = align_robust(source, target)
    np.testing.assert_allclose(found.apply(source)[9:], target[9:], atol=1e-3)
    assert found.scale == pytest.approx(2.0, rel=1e-3)
    line = np.c_[np.arange(10.0), np.zeros((10, 2))]  # cameras on a straight road
    np.testing.assert_allclose(align_robust(line, line * 3 + 1).apply(line), line * 3 + 1, atol=1e-9)


def test_diameter():
    assert diameter(np.zeros((1, 3))) == 0
    assert diameter(np.array([[0.0, 0, 0], [3, 4, 0], [1, 1, 0]])) == 5
    cloud = np.random.default_rng(0).normal(size=(700, 3))
    cloud[13], cloud[14] = [50, 0, 0], [-50, 0, 0]
    assert diameter(cloud) == pytest.approx(100)
    assert diameter(np.c_[np.linspace(0, 7, 600), np.zeros((600, 2))]) == pytest.approx(7)


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("a.jpg", "a.jpg"),
        ("./a//b.jpg", "a/b.jpg"),
        ("a/../b.jpg", "b.jpg"),
        ("a\\b.jpg", "a/b.jpg"),
        ("..a.jpg", "..a.jpg"),
        ("../a.jpg", None),
        ("a/../../b.jpg", None),
        ("/a.jpg", None),
        ("C:/a.jpg", None),
        ("", None),
        (".", None),
        ("a\nb.jpg", None),
        ("a\udcff.jpg", None),
    ],
)
def test_names_stay_inside(name, plain):
    assert inside(name) == plain


def make_views(folder) -> Views:
    rng = np.random.default_rng(0)
    for i in range(3):
        cv2.imwrite(str(folder / f"{i}.png"), rng.integers(0, 256, (4, 6, 3), dtype=np.uint8))
    mask = np.zeros((4, 6), np.uint8)
    mask[:2] = 255
    cv2.imwrite(str(folder / "m.png"), mask)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [0, 1, 2]
    return Views(
        folder=folder,
        names=("a", "b", "c"),
        images=("0.png", "1.png", "2.png"),
        masks=(None, "m.png", None),
        sizes=np.array([[6, 4]] * 3),
        Ks=np.tile(np.eye(3), (3, 1, 1)),
        viewmats=poses,
        is_test=np.array([True, False, False]),
        missing_test=("z",),
    )


def test_views_round_trip_and_read(tmp_path):
    views = make_views(tmp_path)
    views.save(tmp_path)
    back = Views.load(tmp_path)
    assert (back.names, back.images, back.masks) == (views.names, views.images, views.masks)
    assert back.missing_test == ("z",)
    np.testing.assert_array_equal(back.is_test, views.is_test)
    np.testing.assert_array_equal(back.centers, [[0, 0, 0], [-1, 0, 0], [-2, 0, 0]])
    image, mask = back.read(1)
    np.testing.assert_array_equal(image, cv2.imread(str(tmp_path / "1.png"))[..., ::-1])  # RGB
    assert mask.dtype == bool
    assert mask.sum() == 12
    (tmp_path / "0.png").unlink()
    with pytest.raises(OSError, match=r"0\.png"):
        back.read(0)


def test_image_cache_keeps_to_its_budget(tmp_path):
    views = make_views(tmp_path)
    one = 4 * 6 * 3
    cache = ImageCache(views, budget_bytes=2 * one + 24)
    first = cache.get(0)[0]
    assert cache.get(0)[0] is first
    cache.get(1)
    assert cache.nbytes == 2 * one + 24
    cache.get(0)
    cache.get(2)  # drops 1, the least recently used
    assert cache.nbytes == 2 * one
    assert cache.get(0)[0] is first
    assert ImageCache(views, budget_bytes=0).get(0)[0].shape == (4, 6, 3)
