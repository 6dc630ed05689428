"""Waymo, Mill-19 and nuScenes layouts, made up: where photos and poses are found, their axes, and what is refused."""

import io
import json
import pickle
import zipfile

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.sources import Photos, SourcesConfig, fingerprint, load_photos, read_poses, scan
from graphgs.sources.pt_file import read_pt
from tests.support.pictures import write_photos

OPENCV_FROM_WAYMO = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # x forward, y left, z up to x right, y down


def load(source, folder) -> Photos:
    return load_photos(SourcesConfig(), source, folder, reporter=Reporter(), threads=1)


def projected(given, i, point) -> np.ndarray:
    x = given.rotations[i] @ point + given.translations[i]
    return (given.camera_of(i).K @ x)[:2] / x[2]


# ---------------------------------------------------------------- torch.save files without torch


def test_what_torch_saves_is_read(tmp_path):
    views = torch.arange(24, dtype=torch.float32).reshape(4, 6)[1:, ::2].t()
    saved = {
        "H": 3,
        "view": views,
        "double": torch.rand(2, 3, dtype=torch.float64),
        "half": torch.tensor([1.5], dtype=torch.float16),
        "scalar": torch.tensor(7),
        "flags": torch.tensor([True, False]),
        "empty": torch.zeros(0, 3),
        "nested": [1.5, ("a", None)],
    }
    torch.save(saved, tmp_path / "x.pt")
    read = read_pt(tmp_path / "x.pt")
    assert read.keys() == saved.keys()
    for key, value in saved.items():
        if isinstance(value, torch.Tensor):
            np.testing.assert_array_equal(read[key], value.numpy())
            assert read[key].dtype == value.numpy().dtype
        else:
            assert read[key] == value


class Evil:
    def __reduce__(self):
        return (open, ("/tmp/should-not-be-there", "w"))


def archive(path, pickled: bytes, storage: bytes = b""):
    with zipfile.ZipFile(path, "w") as out:
        out.writestr("x/data.pkl", pickled)
        out.writestr("x/data/0", storage)


def test_pt_files_that_do_more_than_hold_tensors(tmp_path):
    path = tmp_path / "x.pt"
    buffer = io.BytesIO()
    torch.save({"a": torch.zeros(3)}, buffer)
    whole = buffer.getvalue()
    cases = [b"", b"words", whole[: len(whole) // 2], pickle.dumps({"a": 1})]
    for content in cases:
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"torch\.save"):
            read_pt(path)
    archive(path, pickle.dumps(Evil()))
    with pytest.raises(ValueError, match="not allowed"):
        read_pt(path)
    archive(path, b"\x80\x02N")  # no end
    with pytest.raises(ValueError, match="damaged"):
        read_pt(path)
    with zipfile.ZipFile(io.BytesIO(whole)) as good:  # a storage shorter than its tensor
        pickled = good.read(next(name for name in good.namelist() if name.endswith("data.pkl")))
    archive(path, pickled, b"\0" * 4)
    with pytest.raises(ValueError, match="cut short"):
        read_pt(path)
    torch.save(torch.nn.Linear(1, 1), path)
    with pytest.raises(ValueError, match="not allowed"):
        read_pt(path)


# ---------------------------------------------------------------- Mill-19


def write_mill19(folder, *, count=3):
    """Cameras above the ground, looking down; x east. Returns centres by name."""
    # OpenGL axes of a camera that looks down with the picture's top to the north: x east, y north, z up. The world of
    # Mega-NeRF is x down, y right (east), z backwards.
    east, north, up = np.array([0, 1.0, 0]), np.array([0, 0, -1.0]), np.array([-1.0, 0, 0])
    centers = {}
    for k, split in enumerate(["train"] * count + ["val"]):
        (name,) = write_photos(folder / split / "rgbs", 1, first=k)
        (folder / split / "metadata").mkdir(exist_ok=True)
        center = 0.1 * k * east + 0.5 * up
        c2w = np.stack([east, north, up, center], axis=1)
        metadata = {
            "H": 40,
            "W": 48,
            "c2w": torch.tensor(c2w, dtype=torch.float32),
            "intrinsics": torch.tensor([50.0, 50.0, 24.0, 20.0]),
            "distortion": torch.zeros(5),
        }
        torch.save(metadata, folder / split / "metadata" / f"{name[:-4]}.pt")
        centers[f"{split}/rgbs/{name}"] = center
    return centers


def test_mill19(tmp_path):
    source = tmp_path / "in"
    centers = write_mill19(source)
    write_photos(source / "elsewhere", 2)
    photos = load(source, tmp_path / "out")
    assert scan(source).kind == "mill19"
    assert photos.names == photos.given.names == tuple(sorted(centers))
    np.testing.assert_allclose(photos.given.centers, [centers[name] for name in photos.names], atol=1e-6)
    # What lies below the first camera is in the middle of its picture; to its north (-z of this world) is up.
    np.testing.assert_allclose(projected(photos.given, 0, np.array([0, 0, 0.0])), [24, 20], atol=1e-4)
    np.testing.assert_allclose(projected(photos.given, 0, np.array([0, 0.1, -0.05])), [34, 15], atol=1e-3)
    assert photos.rigs == ()

    before = fingerprint(source)
    (source / "train/metadata/0001.pt").unlink()
    assert fingerprint(source) != before
    assert len(load(source, tmp_path / "out").given.names) == 3  # a photo without metadata has no pose
    torch.save({"H": 40}, source / "train/metadata/0000.pt")
    with pytest.raises(DataError, match=r"0000\.pt: no metadata"):
        load(source, tmp_path / "out")


# ---------------------------------------------------------------- Waymo

# FRONT looks ahead, FRONT_LEFT a quarter to the left; vehicle: x forward, y left, z up
MOUNTS = [(np.eye(3), [1.5, 0.0, 2.0]), (Rotation.from_euler("z", 45, degrees=True).as_matrix(), [1.4, 0.2, 2.0])]


def matrix(rotation, place) -> np.ndarray:
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = rotation, place
    return m


def write_waymo(folder, *, flat: bool, opencv: bool, frames: int = 3):
    for part in ("ego_pose", "extrinsics", "intrinsics"):
        (folder / part).mkdir(parents=True)
    for camera, (rotation, place) in enumerate(MOUNTS):
        label = str(camera) if flat else ("FRONT", "FRONT_LEFT")[camera]
        turned = rotation @ OPENCV_FROM_WAYMO.T if opencv else rotation
        np.savetxt(folder / "extrinsics" / f"{label}.txt", matrix(turned, place))
        np.savetxt(folder / "intrinsics" / f"{label}.txt", [50, 52, 24, 20, 0.01, 0, 0, 0, 0])
        for k in range(frames):
            place = folder / ("images" if flat else label)
            (old,) = write_photos(place, 1, first=10 * camera + k)
            (place / old).rename(place / (f"{k:06d}_{camera}.png" if flat else f"{k:06d}.png"))
    for k in range(frames):
        heading = Rotation.from_euler("z", 10 * k, degrees=True).as_matrix()
        np.savetxt(folder / "ego_pose" / f"{k:06d}.txt", matrix(heading, [100.0 + 2 * k, 50, 0]))


@pytest.mark.parametrize("opencv", [False, True])
@pytest.mark.parametrize("flat", [False, True])
def test_waymo(tmp_path, flat, opencv):
    source = tmp_path / "in"
    write_waymo(source, flat=flat, opencv=opencv)
    photos = load(source, tmp_path / "out")
    assert scan(source).kind == "waymo"
    given = photos.given
    assert len(given.names) == 6
    front = given.names.index("images/000000_0.png" if flat else "FRONT/000000.png")
    left = given.names.index("images/000000_1.png" if flat else "FRONT_LEFT/000000.png")
    np.testing.assert_allclose(given.centers[front] + photos.origin, [101.5, 50, 2], atol=1e-9)
    # 10 m ahead of FRONT, 1 m to the right (-y) and 1 m down
    seen = np.array([101.5 + 10, 50 - 1, 2 - 1]) - photos.origin
    np.testing.assert_allclose(projected(given, front, seen), [24 + 5, 20 + 5.2], atol=1e-9)
    np.testing.assert_allclose(given.rotations[left, 2], [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-9)
    assert given.camera_of(front).model == "OPENCV"
    assert [rig.folders for rig in photos.rigs] == ([] if flat else [("FRONT", "FRONT_LEFT")])


def test_waymo_without_some_of_its_files(tmp_path):
    source = tmp_path / "in"
    write_waymo(source, flat=False, opencv=False, frames=4)
    (source / "ego_pose/000001.txt").unlink()
    assert len(load(source, tmp_path / "out").given.names) == 6
    np.savetxt(source / "extrinsics/FRONT.txt", np.diag([1.0, -1, -1, 1]))  # upside down by both conventions
    with pytest.raises(DataError, match=r"FRONT\.txt: the camera is not upright"):
        load(source, tmp_path / "out")
    (source / "extrinsics/FRONT.txt").unlink()
    with pytest.raises(DataError, match="no extrinsics or intrinsics of camera 0"):
        load(source, tmp_path / "out")
    for part in ("ego_pose", "extrinsics", "intrinsics"):
        for path in (source / part).iterdir():
            path.unlink()
        (source / part).rmdir()
    plain = load(source, tmp_path / "out")
    assert plain.given is None
    assert plain.rigs[0].folders == ("FRONT", "FRONT_LEFT")


# ---------------------------------------------------------------- nuScenes


def entry(name, *, ego=None, rotation=(1, 0, 0, 0), translation=(0, 0, 0)):
    plain = {
        "filename": name,
        "rotation": list(rotation),
        "translation": list(translation),
        "camera_intrinsic": [[50, 0, 24], [0, 52, 20], [0, 0, 1]],
    }
    return plain | ({} if ego is None else {"ego_pose": ego})


def test_nuscenes(tmp_path):
    names = [f"CAM_FRONT/{name}" for name in write_photos(tmp_path / "CAM_FRONT", 3)]
    turn = Rotation.from_euler("y", 30, degrees=True)
    wxyz = turn.as_quat()[[3, 0, 1, 2]].tolist()
    ego = {"rotation": wxyz, "translation": [5, 0, 7]}
    file = tmp_path / "poses.json"
    entries = [entry(names[0], rotation=wxyz, translation=[1, 2, 3]), entry(names[1], translation=[1, 0, 0], ego=ego)]
    file.write_text(json.dumps([*entries, entry(names[2])]))
    photos = load(file, tmp_path / "out")
    assert photos.given.names == tuple(names)
    np.testing.assert_allclose(photos.given.rotations[0], turn.inv().as_matrix(), atol=1e-12)
    np.testing.assert_allclose(photos.given.centers[:2], [[1, 2, 3], turn.apply([1, 0, 0]) + [5, 0, 7]], atol=1e-12)
    np.testing.assert_allclose(photos.given.cameras[0].params, (50, 52, 24, 20))
    plain = load(tmp_path / "CAM_FRONT", tmp_path / "plain")
    found, rotations, centers = read_poses(file, plain)
    assert found == plain.names
    np.testing.assert_allclose(centers, photos.given.centers)
    np.testing.assert_allclose(rotations, photos.given.rotations)


@pytest.mark.parametrize(
    "content",
    [
        "[",
        "[]",
        "[7]",
        "[{}]",
        json.dumps([entry("../x.png")]),
        json.dumps([entry("x.png"), entry("./x.png")]),
        json.dumps([entry("x.png", rotation=(0, 0, 0, 0))]),
        json.dumps([entry("x.png", rotation=(1, 0, 0))]),
        json.dumps([entry("x.png") | {"camera_intrinsic": [[0, 0, 0]] * 3}]),
        json.dumps([entry("x.png", ego={"rotation": [1, 0, 0, 0]})]),
    ],
)
def test_broken_nuscenes_lists_are_named(tmp_path, content):
    write_photos(tmp_path, 3)
    (tmp_path / "poses.json").write_text(content)
    with pytest.raises(DataError, match=r"poses\.json") as caught:
        load(tmp_path / "poses.json", tmp_path / "out")
    assert caught.value.hint
