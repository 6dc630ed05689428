"""OUTPUT/colmap: pycolmap opens it, image sizes and names agree, and the points project onto their observations."""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from graphgs.errors import DataError
from graphgs.export.colmap import file_names, undistort_points, write_colmap
from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.colmap import read_model
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.views import Views
from graphgs.sources.photos import Photo, Photos

NAMES = ("a.jpg", "b.tif", "left/c.JPEG", "left/d.png")
OPENCV = Camera("OPENCV", 160, 120, (130.0, 131.0, 80.5, 59.0, -0.18, 0.05, 0.002, -0.001))
FISHEYE = Camera("OPENCV_FISHEYE", 160, 120, (95.0, 96.0, 80.0, 60.5, 0.04, -0.01, 0.003, -0.001))


def distort(camera: Camera, points: np.ndarray) -> np.ndarray:
    """[M, 2] px of [M, 3] points in the camera frame."""
    source = points.reshape(-1, 1, 3)
    if camera.is_fisheye:
        return cv2.fisheye.projectPoints(source, np.zeros(3), np.zeros(3), camera.K, camera.distortion)[0].reshape(
            -1, 2
        )
    distortion = camera.distortion if len(camera.distortion) else None
    return cv2.projectPoints(source, np.zeros(3), np.zeros(3), camera.K, distortion)[0].reshape(-1, 2)


def scene(folder: Path, *, offset_px: float = 0.0) -> tuple[Views, Reconstruction]:
    """Four photos by two distorted cameras that see the same 30 points; views half a photo's size."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-1, -0.7, 3], [1, 0.7, 5], (30, 3))
    cameras, camera_ids = (OPENCV, FISHEYE), np.array([0, 0, 1, 1])
    turns = [cv2.Rodrigues(np.array([0.0, 0.05 * k, 0.02 * k]))[0] for k in range(4)]
    translations = np.array([[0.1 * k, 0.0, 0.05 * k] for k in range(4)])
    seen = np.stack(
        [distort(cameras[c], points @ R.T + t) for c, R, t in zip(camera_ids, turns, translations, strict=True)]
    )
    reconstruction = Reconstruction(
        cameras=cameras,
        names=NAMES,
        camera_ids=camera_ids,
        rotations=np.stack(turns),
        translations=translations,
        points=points,
        colors=rng.integers(0, 256, (30, 3)).astype(np.uint8),
        errors=np.full(30, 0.5),
        track_offsets=np.arange(31) * 4,
        track_images=np.tile(np.arange(4), 30).astype(np.int32),
        track_xy=seen.transpose(1, 0, 2).reshape(-1, 2) + [offset_px, 0.0],
    )
    sizes = np.array([[80, 60], [80, 60], [76, 58], [76, 58]])
    Ks = np.array([[[62.0, 0, w / 2], [0, 63.0, h / 2], [0, 0, 1]] for w, h in sizes])
    images = []
    for k, (width, height) in enumerate(sizes):
        picture = cv2.resize(rng.integers(0, 256, (6, 8, 3)).astype(np.uint8), (int(width), int(height)))
        images.append(f"{k}.png")
        cv2.imwrite(str(folder / images[-1]), picture)
    viewmats = np.tile(np.eye(4), (4, 1, 1))
    viewmats[:, :3, :3], viewmats[:, :3, 3] = reconstruction.rotations, translations
    return Views(folder, NAMES, tuple(images), (None,) * 4, sizes, Ks, viewmats, np.arange(4) == 0), reconstruction


@pytest.mark.parametrize("camera", [OPENCV, FISHEYE, Camera("SIMPLE_RADIAL", 160, 120, (120.0, 80.0, 60.0, -0.3))])
def test_undistorted_observations_lie_on_the_pinhole_projection(camera: Camera):
    rng = np.random.default_rng(1)
    points = rng.uniform([-0.5, -0.4, 1], [0.5, 0.4, 1.2], (200, 3))
    K = np.array([[70.0, 0, 41.0], [0, 72.0, 29.0], [0, 0, 1]])
    expected = points @ K.T
    found = undistort_points(distort(camera, points), camera, K)
    np.testing.assert_allclose(found, expected[:, :2] / expected[:, 2:], atol=1e-5)


def test_pycolmap_opens_it(tmp_path):
    views, reconstruction = scene(tmp_path)
    write_colmap(tmp_path / "colmap", views, reconstruction, threads=2)
    code = """
import zlib, numpy, json, sys, pycolmap
out = {}
for place in ("sparse/0", "original"):
    model = pycolmap.Reconstruction(sys.argv[1] + "/" + place)
    out[place] = {
        "images": {i.name: [i.camera.model.name, i.camera.width, i.camera.height] for i in model.images.values()},
        "registered": model.num_reg_images(),
        "tracks": sorted(p.track.length() for p in model.points3D.values()),
        "error": float(model.compute_mean_reprojection_error()),
    }
print(json.dumps(out))
"""
    command = [sys.executable, "-c", code, str(tmp_path / "colmap")]
    out = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    flat, original = out["sparse/0"], out["original"]
    assert set(flat["images"]) == {"a.jpg", "b.tif.png", "left/c.JPEG", "left/d.png"}
    for name, (model, width, height) in flat["images"].items():
        assert model == "PINHOLE"
        assert Image.open(tmp_path / "colmap" / "images" / name).size == (width, height)
    assert flat["registered"] == original["registered"] == 4
    assert flat["tracks"] == original["tracks"] == [4] * 30
    assert flat["error"] < 1e-4
    assert original["images"] == {
        "a.jpg": ["OPENCV", 160, 120],
        "b.tif": ["OPENCV", 160, 120],
        "left/c.JPEG": ["OPENCV_FISHEYE", 160, 120],
        "left/d.png": ["OPENCV_FISHEYE", 160, 120],
    }


def test_images_keep_their_format_and_pixels(tmp_path):
    views, reconstruction = scene(tmp_path)
    write_colmap(tmp_path / "colmap", views, reconstruction)
    for i, name in enumerate(file_names(NAMES)):
        with Image.open(tmp_path / "colmap" / "images" / name) as image:
            lossless = name.endswith(".png")
            assert image.format == ("PNG" if lossless else "JPEG")
            if not lossless:
                assert [layer[1:3] for layer in image.layer] == [(1, 1)] * 3  # 4:4:4
            worst = np.abs(np.asarray(image).astype(int) - views.read(i)[0]).max()
            assert worst <= (0 if lossless else 6)


def test_errors_are_those_of_the_views_pixels(tmp_path):
    views, reconstruction = scene(tmp_path, offset_px=1.0)
    write_colmap(tmp_path / "colmap", views, reconstruction)
    errors = read_model(tmp_path / "colmap" / "sparse" / "0").errors
    assert 0.3 < np.median(errors) < 0.8  # 1 px of photos with twice the views' focal length


def test_original_sizes_scale_cameras_and_observations(tmp_path):
    views, reconstruction = scene(tmp_path)
    first = Photo("a.jpg", "a.png", 160, 120, 640, 480, None, None, "k", "", None, None)
    write_colmap(tmp_path / "colmap", views, reconstruction, Photos(tmp_path, (first,)))
    model = read_model(tmp_path / "colmap" / "original")
    assert model.camera_of(0) == OPENCV.scaled_to(640, 480)
    assert model.camera_of(1) == OPENCV
    in_first = model.track_images == 0
    np.testing.assert_allclose(model.track_xy[in_first], 4 * reconstruction.track_xy[in_first])
    np.testing.assert_allclose(model.track_xy[~in_first], reconstruction.track_xy[~in_first])


def test_views_left_out_take_their_observations_along(tmp_path):
    views, reconstruction = scene(tmp_path)
    lonely = np.append(
        reconstruction.track_offsets, [121, 121]
    )  # a point only the last photo sees, and one without a track
    reconstruction = Reconstruction(
        **{
            **{name: getattr(reconstruction, name) for name in reconstruction.__dataclass_fields__},
            "points": np.vstack([reconstruction.points, [[0, 0, 4], [0, 0, 9]]]),
            "colors": np.vstack([reconstruction.colors, [[1, 2, 3], [4, 5, 6]]]).astype(np.uint8),
            "errors": np.append(reconstruction.errors, [0.1, -1.0]),
            "track_offsets": lonely,
            "track_images": np.append(reconstruction.track_images, 3).astype(np.int32),
            "track_xy": np.vstack([reconstruction.track_xy, [[80.0, 60.0]]]),
        }
    )
    part = Views(
        views.folder, NAMES[:3], views.images[:3], (None,) * 3, views.sizes[:3], views.Ks[:3], views.viewmats[:3],
        views.is_test[:3],
    )  # fmt: skip
    write_colmap(tmp_path / "colmap", part, reconstruction)
    model = read_model(tmp_path / "colmap" / "sparse" / "0")
    assert model.names == file_names(NAMES[:3])
    assert model.track_lengths.tolist() == [3] * 30 + [0]
    assert model.errors[-1] == -1.0
    assert len(read_model(tmp_path / "colmap" / "original").names) == 4


def test_a_second_export_replaces_the_first_and_progress_is_told(tmp_path):
    class Told(Reporter):
        calls: list = []  # noqa: RUF012

        def progress(self, done, total, note=""):
            self.calls.append((done, total))

    views, reconstruction = scene(tmp_path)
    stale = tmp_path / "colmap" / "images" / "old.jpg"
    stale.parent.mkdir(parents=True)
    stale.write_bytes(b"")
    told = Told()
    write_colmap(tmp_path / "colmap", views, reconstruction, reporter=told)
    assert not stale.exists()
    assert not (tmp_path / "colmap.partial").exists()
    assert told.calls == [(k, 4) for k in (1, 2, 3, 4)]


def test_file_names_are_unique_and_stay_inside():
    assert file_names(("a.tif", "a.tif.png", "b.WEBP")) == ("a.tif.png.png", "a.tif.png", "b.WEBP.png")
    for bad in ("../a.jpg", "/etc/a.jpg", "x/../../a.jpg"):
        with pytest.raises(DataError, match="not a path inside"):
            file_names((bad,))


def test_a_view_without_a_camera_is_refused(tmp_path):
    views, reconstruction = scene(tmp_path)
    stranger = Views(**{**views.__dict__, "names": ("zzz.jpg", *NAMES[1:])})
    with pytest.raises(DataError, match=r"1 views are not in the reconstruction: zzz\.jpg"):
        write_colmap(tmp_path / "colmap", stranger, reconstruction)
