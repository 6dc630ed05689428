"""Undistortion against analytic patterns: half pixels, models, blank borders, masks."""

import dataclasses

import cv2
import numpy as np
import pytest

from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.views import Views
from graphgs.sources.photos import Photo, Photos
from graphgs.structure.config import StructureConfig
from graphgs.structure.undistort import undistort, undistortion

CAMERAS = {
    "pinhole": Camera.pinhole(120, 80, 90.0, 90.0, 61.0, 39.0),
    "barrel": Camera("SIMPLE_RADIAL", 120, 80, (90.0, 60.0, 40.0, -0.12)),
    "pincushion": Camera("RADIAL", 120, 80, (90.0, 58.0, 41.0, 0.1, 0.02)),
    "tangential": Camera("OPENCV", 120, 80, (90.0, 92.0, 60.0, 40.0, -0.05, 0.01, 0.004, -0.006)),
    "fisheye": Camera("OPENCV_FISHEYE", 120, 80, (60.0, 60.0, 60.0, 40.0, -0.02, 0.003, 0.0, 0.0)),
}


def distorted(camera, rays):
    """[..., 2] px of rays (x, y) at depth 1, pixel centres at +0.5: COLMAP's camera models, written out."""
    x, y = rays[..., 0], rays[..., 1]
    fx, fy, cx, cy = camera.focal_and_center
    r2 = x * x + y * y
    if camera.is_fisheye:
        r = np.sqrt(np.maximum(r2, 1e-20))
        theta = np.arctan(r)
        k1, k2, k3, k4 = camera.params[4:]
        bent = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8) / r
        u, v = x * bent, y * bent
    else:
        k1, k2, p1, p2 = (list(camera.distortion) + [0.0] * 4)[:4]
        radial = 1 + k1 * r2 + k2 * r2 * r2
        u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)
    return np.stack([fx * u + cx, fy * v + cy], axis=-1)


def pixel_rays(camera):
    """[H, W, 2] of a pinhole camera's pixel centres."""
    fx, fy, cx, cy = camera.focal_and_center
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return np.stack([(x - cx) / fx, (y - cy) / fy], axis=-1)


@pytest.mark.parametrize("name", list(CAMERAS))
def test_maps_follow_the_camera_model_to_a_thousandth_of_a_pixel(name):
    camera = CAMERAS[name]
    plan = undistortion(camera)
    expected = distorted(camera, pixel_rays(plan.camera)) - 0.5  # OpenCV counts from pixel centres
    if plan.map_x is None:
        grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
        np.testing.assert_allclose(expected, grid, atol=1e-9)
    else:
        np.testing.assert_allclose(np.stack([plan.map_x, plan.map_y], -1), expected, atol=2e-3)


@pytest.mark.parametrize("name", list(CAMERAS))
def test_no_pixel_is_blank_and_little_is_cut_off(name):
    camera = CAMERAS[name]
    plan = undistortion(camera)
    assert plan.valid is None
    assert plan.camera.model == "PINHOLE"
    assert (plan.camera.width, plan.camera.height) == (camera.width, camera.height)
    # On each axis some border pixel comes from within two pixels of the photo's border, on the axis that binds.
    x, y = np.moveaxis(distorted(camera, pixel_rays(plan.camera)), -1, 0)
    gaps = [x.min(), camera.width - x.max(), y.min(), camera.height - y.max()]
    assert min(gaps) < 2.0
    fx, fy, _, _ = plan.camera.focal_and_center
    given = camera.focal_and_center
    assert fx / fy == pytest.approx(given[0] / given[1])


def photos_with(folder, images, camera, masks=None):
    (folder / "photos").mkdir(parents=True)
    entries = []
    for k, image in enumerate(images):
        cv2.imwrite(str(folder / f"photos/{k:06d}.png"), image[..., ::-1])
        mask = None
        if masks is not None and masks[k] is not None:
            (folder / "masks").mkdir(exist_ok=True)
            mask = f"masks/{k:06d}.png"
            cv2.imwrite(str(folder / mask), masks[k])
        size = (camera.width, camera.height)
        entries.append(
            Photo(f"{k:02d}.jpg", f"photos/{k:06d}.png", *size, *size, mask, None, "one", str(k), None, None)
        )
    photos = Photos(folder, tuple(entries))
    n = len(images)
    reconstruction = Reconstruction(
        cameras=(camera,),
        names=photos.names,
        camera_ids=np.zeros(n, np.int64),
        rotations=np.tile(np.eye(3), (n, 1, 1)),
        translations=np.arange(3.0 * n).reshape(n, 3),
    )
    return photos, reconstruction


def ramp(camera):
    """A photo whose red is its x and whose green is its y in px: what a pixel shows says where it came from."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return np.stack([x, y, 0 * x], axis=-1).astype(np.uint8)


@pytest.mark.parametrize("name", ["barrel", "tangential", "fisheye"])
def test_images_show_the_ray_their_matrix_says(name, tmp_path):
    camera = CAMERAS[name]
    photos, model = photos_with(tmp_path / "in", [ramp(camera)] * 3, camera)
    views = undistort(StructureConfig(), photos, model, tmp_path / "out", reporter=Reporter(), threads=2)
    image, mask = views.read(0)
    assert mask is None
    pinhole = Camera.pinhole(120, 80, *views.Ks[0, [0, 1, 0, 1], [0, 1, 2, 2]])
    source = distorted(camera, pixel_rays(pinhole))
    # The ramp is floor(x + 0.5 - 0.5): a value v stands for the pixel centre v + 0.5; 8 bits round by half.
    error = image[..., :2].astype(float) + 0.5 - source
    assert np.abs(error).max() < 0.75
    assert np.abs(error.mean((0, 1))).max() < 0.05


def test_reduction_is_by_area_and_keeps_pixel_centres(tmp_path):
    camera = Camera.pinhole(120, 80, 90.0, 90.0, 61.0, 39.0)
    photos, model = photos_with(tmp_path / "in", [ramp(camera)] * 3, camera)
    config = StructureConfig(max_side=40)
    views = undistort(config, photos, model, tmp_path / "out", reporter=Reporter(), threads=1)
    image, _ = views.read(1)
    assert image.shape == (27, 40, 3)
    assert views.sizes.tolist() == [[40, 27]] * 3
    # Each pixel is the mean of the block it covers: its value is its centre, three times as far out.
    expected = 3 * (np.arange(40) + 0.5) - 0.5
    np.testing.assert_allclose(image[13, :, 0].astype(float), expected, atol=0.51)
    np.testing.assert_allclose(views.Ks[0], [[30, 0, 61 / 3], [0, 90 * 27 / 80, 39 * 27 / 80], [0, 0, 1]])
    np.testing.assert_array_equal(views.viewmats[:, :3, 3], model.translations)


def test_masks_follow_the_pixels(tmp_path):
    camera = CAMERAS["barrel"]
    mask = np.full((80, 120), 255, np.uint8)
    mask[:, :60] = 0
    photos, model = photos_with(tmp_path / "in", [ramp(camera)] * 3, camera, [mask, None, None])
    views = undistort(StructureConfig(max_side=60), photos, model, tmp_path / "out", reporter=Reporter(), threads=1)
    image, kept = views.read(0)
    assert views.masks[1] is None
    assert kept.shape == (40, 60)
    assert not kept[image[..., 0] < 58].any()
    assert kept[image[..., 0] > 62].all()


@pytest.mark.parametrize(("k1", "k2"), [(1.5, 0.0), (-0.5, 0.0), (0.8, -3.3)])
def test_strong_distortion_leaves_masked_pixels_not_wrong_ones(k1, k2):
    # A negative term folds the image over: what lies behind the fold was never seen.
    camera = Camera("RADIAL", 120, 80, (60.0, 60.0, 40.0, k1, k2))
    plan = undistortion(camera)
    rays = pixel_rays(plan.camera)
    source = distorted(camera, rays)
    r = np.linalg.norm(rays, axis=-1)
    outside = (source < -0.01).any(-1) | (source[..., 0] > 120.01) | (source[..., 1] > 80.01)
    folded = 1 + 3 * k1 * r**2 + 5 * k2 * r**4 < -0.01
    valid = np.full((80, 120), 255) if plan.valid is None else plan.valid
    assert not (valid[outside | folded] > 0).any()
    assert valid.mean() > 0.3 * 255
    assert 0.3 < plan.camera.params[0] / 60.0 < 3.0


def test_test_views_and_missing_ones_are_those_of_the_photos(tmp_path):
    camera = CAMERAS["pinhole"]
    photos, model = photos_with(tmp_path / "in", [ramp(camera)] * 17, camera)
    keep = np.array([k for k in range(17) if k not in (3, 8)])
    part = dataclasses.replace(
        model,
        names=tuple(np.array(photos.names)[keep]),
        camera_ids=model.camera_ids[keep],
        rotations=model.rotations[keep],
        translations=model.translations[keep],
    )
    views = undistort(StructureConfig(), photos, part, tmp_path / "out", reporter=Reporter(), threads=2)
    assert views.missing_test == ("08.jpg",)
    assert [name for name, test in zip(views.names, views.is_test, strict=True) if test] == ["00.jpg", "16.jpg"]
    views.save(tmp_path / "out")
    assert Views.load(tmp_path / "out").names == views.names
    again = undistort(StructureConfig(), photos, part, tmp_path / "again", reporter=Reporter(), threads=1)
    for file in again.images:
        assert (tmp_path / "again" / file).read_bytes() == (tmp_path / "out" / file).read_bytes()
