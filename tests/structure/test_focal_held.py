"""A focal length that bundle adjustment would not find is held, and said to be."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from graphgs.scene.camera import Camera
from graphgs.structure.cameras import SharedCameras
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.focal_held import cautions, held_note, is_observable
from graphgs.structure.prior import Prior


class Answering:
    """Stands for the worker: errors at the found focal length, below it and above it."""

    def __init__(self, *errors):
        self.errors = errors

    def run(self, job, **arguments):
        assert job == "focal_response"
        assert len(arguments["scales"]) == len(self.errors)
        return {"errors": list(self.errors)}


@pytest.mark.parametrize(
    ("errors", "observable"),
    [
        ((0.5, 0.56, 0.53), True),
        ((0.5, 0.4999, 0.5003), False),  # straight driving
        ((0.5, 0.9, 0.5003), False),  # one side alone does not bound it
        ((0.5, math.nan, 0.6), True),  # an adjustment that came apart
    ],
)
def test_the_photos_must_object_to_both_sides(errors, observable):
    assert is_observable(Answering(*errors), Path(), seed=0, threads=1)[0] is observable


def test_what_is_held_is_said():
    cameras = tuple(Camera("SIMPLE_RADIAL", 1226, 370, (f, 613.0, 185.0, 0.0)) for f in (885.44, 707.1))
    shared = SharedCameras(cameras, (True, True), np.array([0, 1]))
    assert held_note(shared, (False, True)) == (
        "focal length held at 707 px (EXIF), 885 px (typical): straight driving does not show it"
    )


def prior_of(cameras, **fields):
    return Prior(
        ("a", "b"), np.ones(2, bool), np.tile(np.eye(3), (2, 1, 1)), np.eye(3)[:2], cameras, True, "auto", **fields
    )


def test_a_focal_length_that_nobody_knows_is_a_caution():
    cameras = tuple(Camera("SIMPLE_RADIAL", 1226, 370, (f, 613.0, 185.0, 0.0)) for f in (885.44, 707.1))
    shared = SharedCameras(cameras, (True, True), np.array([0, 1]))
    (said,) = cautions(prior_of(shared, focal_open=True), (False, True))
    assert "held at 885 px, a typical one" in said
    assert "stretched along the drive" in said
    assert "sources.focal_px" in said
    assert not cautions(prior_of(shared, focal_open=True), (True, True))  # EXIF or the user told them
    assert not cautions(prior_of(shared), (False, False))


def drive(folder, *, turning):
    """A model of one camera that drives past points, as COLMAP's files; observations have noise."""
    subprocess.run([sys.executable, __file__, str(folder), str(int(turning))], check=True)
    return folder


@pytest.mark.parametrize("turning", [False, True])
def test_driving_straight_does_not_show_the_focal_length_and_turning_does(tmp_path, turning):
    drive(tmp_path / "colmap", turning=turning)
    with ColmapWorker(tmp_path) as worker:
        observable, _ = is_observable(worker, tmp_path, seed=0, threads=1)
    assert observable is turning


def _write_drive(folder: Path, turning: bool) -> None:
    """In a process of its own, as all that loads pycolmap."""
    import zlib  # noqa: F401

    import pycolmap

    rng = np.random.default_rng(0)
    model, n = pycolmap.Reconstruction(), 8
    camera = pycolmap.Camera(
        camera_id=1, model="SIMPLE_RADIAL", width=800, height=600, params=[600.0, 400.0, 300.0, 0.0]
    )
    model.add_camera_with_trivial_rig(camera)
    points = np.stack([rng.uniform(-6, 6, 300), rng.uniform(-3, 3, 300), rng.uniform(14, 40, 300)], 1)
    poses = []
    for k in range(n):
        angle = 0.12 * (k - n / 2) if turning else 0.0
        rotation = pycolmap.Rotation3d(np.array([0.0, angle, 0.0]))
        poses.append(pycolmap.Rigid3d(rotation, -(rotation.matrix() @ np.array([0.05 * k, 0.0, 1.0 * k]))))
    seen = np.array([[camera.img_from_cam(pose * point) for point in points] for pose in poses])
    seen += rng.normal(0, 0.3, seen.shape)
    for k, pose in enumerate(poses):
        image = pycolmap.Image(name=f"{k}.png", keypoints=seen[k], camera_id=1, image_id=k + 1)
        model.add_image_with_trivial_frame(image, pose)
    for p, point in enumerate(points):
        track = pycolmap.Track()
        for k in range(n):
            track.add_element(k + 1, p)
        model.add_point3D(point, track)
    folder.mkdir(parents=True)
    model.write_binary(folder)


if __name__ == "__main__":
    _write_drive(Path(sys.argv[1]), bool(int(sys.argv[2])))
