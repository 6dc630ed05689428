"""Readers of true cameras, against files written by hand and against the real sets."""

import json

import numpy as np
import pytest
from PIL import ExifTags, Image

from bench.shape_sets import real_set
from bench.shape_truth import gps_truth, pose_rows_truth, transforms_truth
from graphgs.scene.similarity import diameter


def test_pose_rows_are_camera_to_world(tmp_path):
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    rows = np.concatenate([np.column_stack([np.eye(3), [1, 2, 3]]), np.column_stack([turn, [4, 5, 6]])])
    np.savetxt(tmp_path / "poses.txt", rows.reshape(2, 12))
    truth = pose_rows_truth({tmp_path / "poses.txt": ("a.png", "b.png")}, focal=0.6)
    np.testing.assert_allclose(truth.centers, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_allclose(truth.rotations[1], turn.T)
    np.testing.assert_allclose(truth.focals, 0.6)
    with pytest.raises(ValueError, match="2 poses for 1 photos"):
        pose_rows_truth({tmp_path / "poses.txt": ("a.png",)}, focal=0.6)


def test_transforms_look_along_their_negative_z_axis(tmp_path):
    pose = np.eye(4)
    pose[:3, 3] = [1, 2, 3]
    content = {
        "fl_x": 700.0, "w": 1000.0, "frames": [{"file_path": "images/0001.jpg", "transform_matrix": pose.tolist()}],
    }  # fmt: skip
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    truth = transforms_truth(tmp_path / "transforms.json")
    assert truth.names == ("0001.jpg",)
    np.testing.assert_allclose(truth.centers, [[1, 2, 3]])
    np.testing.assert_allclose(truth.rotations[0] @ [0, 0, -1], [0, 0, 1])  # ahead
    np.testing.assert_allclose(truth.rotations[0] @ [0, 1, 0], [0, -1, 0])  # up in the world is up in the picture
    np.testing.assert_allclose(truth.focals, 0.7)


def test_gps_is_east_north_up(tmp_path):
    for name, north, height in (("a.jpg", 0.0, 100.0), ("b.jpg", 0.001, 100.0), ("c.jpg", 0.002, 130.0)):
        exif = Image.Exif()
        gps = exif.get_ifd(ExifTags.IFD.GPSInfo)
        degrees, rest = divmod(41.0 + north, 1)
        minutes, rest = divmod(60 * rest, 1)
        gps.update({1: "N", 2: (degrees, minutes, 60 * rest), 3: "W", 4: (83.0, 0.0, 0.0), 5: b"\0", 6: height})
        Image.new("RGB", (8, 8)).save(tmp_path / name, exif=exif)
    Image.new("RGB", (8, 8)).save(tmp_path / "none.jpg")
    truth = gps_truth(tmp_path, noise_m=2.0)
    assert truth.names == ("a.jpg", "b.jpg", "c.jpg")
    np.testing.assert_allclose(truth.centers[1], 0, atol=1e-6)
    np.testing.assert_allclose(truth.centers[2] - truth.centers[1], [0, 111.1, 30], atol=0.2)
    np.testing.assert_allclose(truth.up, [0, 0, 1])


@pytest.mark.parametrize(
    ("name", "photos", "size", "focal"),
    [
        ("kitti_bend", 51, 46.2, 718.856 / 1241),
        ("castle", 30, None, 1379.74 / 1536),
        ("fox", 50, None, 1375.52 / 1080),
        ("kitti_rig", 288, 173.0, 721.5377 / 1242),
        ("seneca_aerial", 167, 444.0, None),
    ],
)
def test_real_sets_have_a_truth_for_every_photo(shared_data, name, photos, size, focal):
    found = real_set(shared_data(name).parent, name)
    assert len(found.photos) == photos
    assert set(found.photos) == set(found.truth.names)
    if size is not None:
        assert diameter(found.truth.centers) == pytest.approx(size, rel=0.1)
    if focal is not None:
        np.testing.assert_allclose(found.truth.focals, focal, rtol=1e-4)


def test_cameras_look_where_they_drive(shared_data):
    """Both conventions at once: a centre or a rotation read the wrong way round would not agree."""
    truth = real_set(shared_data("kitti_bend").parent, "kitti_bend").truth
    step = np.diff(truth.centers, axis=0)
    ahead = (step * truth.rotations[:-1, 2]).sum(1) / np.linalg.norm(step, axis=1)
    assert np.median(ahead) > 0.99
