"""Projection of points and its derivatives, against OpenCV's projection and finite differences."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graphgs.scene.camera import Camera
from graphgs.structure.calibration.lens import opened
from graphgs.structure.calibration.projection import LENS, distort, linearise, rays_of
from graphgs.structure.contradictions import project
from tests.support.lens_scenes import lens_scene

CAMERAS = (
    Camera("SIMPLE_PINHOLE", 800, 600, (600.0, 410.0, 290.0)),
    Camera("SIMPLE_RADIAL", 800, 600, (600.0, 410.0, 290.0, -0.1)),
    Camera("RADIAL", 800, 600, (600.0, 410.0, 290.0, -0.1, 0.03)),
    Camera("OPENCV", 800, 600, (600.0, 620.0, 410.0, 290.0, -0.1, 0.03, 0.002, -0.001)),
    Camera("OPENCV_FISHEYE", 800, 600, (600.0, 620.0, 410.0, 290.0, 0.05, -0.01, 0.002, 0.001)),
    Camera("FULL_OPENCV", 800, 600, (600.0, 620.0, 410.0, 290.0, -0.1, 0.03, 0.002, -0.001, 0.01, 0.02, 0.01, 0.0)),
)


def observations(camera):
    scene = dataclasses.replace(lens_scene("bend"), cameras=(camera,))
    track = np.repeat(np.arange(len(scene.points)), scene.track_lengths)[:200]
    return scene, scene.track_images[:200].astype(np.int64), scene.points[track], scene.track_xy[:200]


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.model)
def test_it_projects_as_opencv_does(camera):
    scene, images, points, seen = observations(camera)
    found = linearise(scene, images, points, seen)
    np.testing.assert_allclose(found.residuals, project(scene, images, points) - seen, atol=1e-8)
    assert found.ahead.all()


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.model)
def test_its_derivatives_are_those_of_finite_differences(camera):
    scene, images, points, seen = observations(camera)
    found, step = linearise(scene, images, points, seen), 1e-5

    def slope(change):
        ahead, behind = (linearise(*change(sign * step)).residuals for sign in (1, -1))
        return (ahead - behind) / (2 * step)

    for axis in range(3):
        unit = np.eye(3)[axis]
        np.testing.assert_allclose(
            found.by_point[:, :, axis], slope(lambda h, u=unit: (scene, images, points + h * u, seen)), atol=1e-4
        )

        def turned(h, unit=unit):
            rotations = Rotation.from_rotvec(h * unit).as_matrix() @ scene.rotations
            translations = -np.einsum("nij,nj->ni", rotations, scene.centers)
            return dataclasses.replace(scene, rotations=rotations, translations=translations), images, points, seen

        def moved(h, unit=unit):
            translations = -np.einsum("nij,nj->ni", scene.rotations, scene.centers + h * unit)
            return dataclasses.replace(scene, translations=translations), images, points, seen

        np.testing.assert_allclose(found.by_pose[:, :, axis], slope(turned), atol=1e-3)
        np.testing.assert_allclose(found.by_pose[:, :, 3 + axis], slope(moved), atol=1e-4)


def test_the_derivatives_by_the_lens_are_those_of_its_parameters():
    camera = opened(CAMERAS[1], ("k1", "k2"))
    scene, images, points, seen = observations(camera)
    found, step = linearise(scene, images, points, seen), 1e-6
    f, cx, cy, k1, k2 = camera.params
    changes = {
        "focal": lambda h: (f * np.exp(h), cx, cy, k1, k2),
        "center_x": lambda h: (f, cx + h * f, cy, k1, k2),
        "center_y": lambda h: (f, cx, cy + h * f, k1, k2),
        "k1": lambda h: (f, cx, cy, k1 + h, k2),
        "k2": lambda h: (f, cx, cy, k1, k2 + h),
    }
    assert tuple(changes) == LENS
    for column, change in enumerate(changes.values()):
        ends = []
        for sign in (1, -1):
            other = dataclasses.replace(scene, cameras=(Camera("RADIAL", 800, 600, change(sign * step)),))
            ends.append(linearise(other, images, points, seen).residuals)
        np.testing.assert_allclose(found.by_lens[:, :, column], (ends[0] - ends[1]) / (2 * step), atol=1e-3)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.model)
def test_rays_are_bent_back(camera):
    rays = np.random.default_rng(0).uniform(-0.6, 0.6, (100, 2))
    fx, fy, cx, cy = camera.focal_and_center
    np.testing.assert_allclose(rays_of(camera, distort(camera, rays) * [fx, fy] + [cx, cy]), rays, atol=1e-7)


def test_a_point_behind_the_camera_says_nothing():
    scene, images, points, seen = observations(CAMERAS[0])
    behind = 2 * scene.centers[images] - points
    found = linearise(scene, images, behind, seen)
    assert not found.ahead.any()
    assert not found.residuals.any()
    assert not found.by_pose.any()
