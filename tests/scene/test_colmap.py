"""COLMAP models: what is written comes back, pycolmap reads it, and foreign bytes end in one clear error."""

import json
import struct
import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graphgs.errors import DataError
from graphgs.scene.camera import MODEL_PARAMS, Camera
from graphgs.scene.colmap import find_model, read_model, write_model
from graphgs.scene.reconstruction import Reconstruction

FIELDS = ("camera_ids", "rotations", "translations", "points", "colors", "errors", "track_offsets", "track_images")


def scene(seed: int = 0) -> Reconstruction:
    """Four images by two cameras, six points with tracks of two to four views (one point without)."""
    rng = np.random.default_rng(seed)
    lengths = [2, 3, 4, 0, 2, 3]
    return Reconstruction(
        cameras=(
            Camera.pinhole(640, 480, 500.0, 510.0, 320.5, 240.25),
            Camera("OPENCV", 100, 80, (90.0, 91.0, 50.0, 40.0, 0.1, -0.02, 0.001, 0.002)),
        ),
        names=("a.jpg", "b.jpg", "sub/c d.jpg", "é.jpg"),
        camera_ids=np.array([0, 0, 1, 0]),
        rotations=Rotation.random(4, random_state=seed).as_matrix(),
        translations=rng.normal(size=(4, 3)),
        points=rng.normal(size=(6, 3)),
        colors=rng.integers(0, 256, (6, 3)).astype(np.uint8),
        errors=rng.random(6),
        track_offsets=np.concatenate([[0], np.cumsum(lengths)]),
        track_images=np.concatenate([rng.choice(4, n, replace=False) for n in lengths]).astype(np.int32),
        track_xy=rng.random((14, 2)) * 100,
    )


def assert_same(a: Reconstruction, b: Reconstruction) -> None:
    assert a.names == b.names
    assert a.cameras == b.cameras
    for name in (*FIELDS, "track_xy"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-12, err_msg=name)


def as_text(folder) -> None:
    """The scene of `scene()` as COLMAP's own exporter writes text, comments and all."""
    scene_ = scene()
    quats = Rotation.from_matrix(scene_.rotations).as_quat()
    seen = {i: [] for i in range(4)}
    rows = []
    for p in range(6):
        track = []
        for t in range(scene_.track_offsets[p], scene_.track_offsets[p + 1]):
            image = int(scene_.track_images[t])
            track += [image + 11, len(seen[image])]
            seen[image].append([*scene_.track_xy[t], p + 5])
        rows.append([p + 5, *scene_.points[p], *scene_.colors[p], scene_.errors[p], *track])
    write = lambda name, lines: (folder / name).write_text("# comment\n" + "\n".join(lines) + "\n")  # noqa: E731
    spell = lambda values: " ".join(str(v) for v in values)  # noqa: E731
    write("cameras.txt", [spell([i + 3, c.model, c.width, c.height, *c.params]) for i, c in enumerate(scene_.cameras)])
    write("points3D.txt", [spell(row) for row in reversed(rows)])
    lines = []
    for i in (2, 0, 3, 1):  # out of order: the reader sorts by name
        x, y, z, w = quats[i]
        pose = [w, x, y, z, *scene_.translations[i], scene_.camera_ids[i] + 3]
        lines += [spell([i + 11, *pose, scene_.names[i]]), spell(v for point in seen[i] for v in point)]
    write("images.txt", lines)


def test_binary_round_trip(tmp_path):
    write_model(scene(), tmp_path / "model")
    assert_same(read_model(tmp_path / "model"), scene())


def test_text_is_read_like_binary(tmp_path):
    as_text(tmp_path)
    assert_same(read_model(tmp_path), scene())


@pytest.mark.parametrize("model", MODEL_PARAMS)
def test_every_camera_model(tmp_path, model):
    camera = Camera(model, 640, 480, tuple(float(100 + i) for i in range(MODEL_PARAMS[model])))
    posed = Reconstruction((camera,), ("a.jpg",), np.zeros(1, int), np.eye(3)[None], np.zeros((1, 3)))
    write_model(posed, tmp_path)
    assert read_model(tmp_path).cameras == (camera,)


def test_names_can_be_replaced(tmp_path):
    write_model(scene(), tmp_path, names=("0.png", "1.png", "2.png", "3.png"))
    assert read_model(tmp_path).names == ("0.png", "1.png", "2.png", "3.png")
    with pytest.raises(ValueError, match="expected 4, got 1"):
        write_model(scene(), tmp_path, names=("0.png",))


PYCOLMAP = """
import sys, json, zlib, numpy, pycolmap
r = pycolmap.Reconstruction(sys.argv[1])
print(json.dumps({
    "names": sorted(i.name for i in r.images.values()),
    "registered": r.num_reg_images(),
    "points": r.num_points3D(),
    "observations": r.compute_num_observations(),
    "tracks": [[[e.image_id, e.point2D_idx] for e in r.points3D[k].track.elements] for k in sorted(r.points3D)],
    "pose": {i.name: i.cam_from_world().matrix().tolist() for i in r.images.values()},
    "error": r.compute_mean_reprojection_error(),
}))
r.write_text(sys.argv[2])
"""


def test_pycolmap_reads_what_we_write_and_we_read_what_it_writes(tmp_path):
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    theirs.mkdir()
    write_model(scene(), ours)
    command = [sys.executable, "-c", PYCOLMAP, str(ours), str(theirs)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout.splitlines()[-1])
    assert seen["names"] == sorted(scene().names)
    assert (seen["registered"], seen["points"], seen["observations"]) == (4, 6, 14)
    assert [len(track) for track in seen["tracks"]] == list(scene().track_lengths)
    for i, name in enumerate(scene().names):
        np.testing.assert_allclose(seen["pose"][name], scene().viewmats[i, :3], atol=1e-9)
    back = read_model(theirs)
    assert back.names == scene().names
    np.testing.assert_allclose(back.points, scene().points, atol=1e-9)
    np.testing.assert_array_equal(back.track_lengths, scene().track_lengths)


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
def test_every_truncation_is_an_error_that_names_the_file(tmp_path, name):
    write_model(scene(), tmp_path)
    whole = (tmp_path / name).read_bytes()
    for size in range(0, len(whole), 7):
        (tmp_path / name).write_bytes(whole[:size])
        with pytest.raises(DataError, match=name) as caught:
            read_model(tmp_path)
        assert caught.value.hint
    (tmp_path / name).write_bytes(whole + b"\0")
    with pytest.raises(DataError, match="1 bytes too many"):
        read_model(tmp_path)


def test_a_count_beyond_the_file_allocates_nothing(tmp_path):
    write_model(scene(), tmp_path)
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        whole = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(struct.pack("<Q", 2**63) + whole[8:])
        with pytest.raises(DataError, match=name):
            read_model(tmp_path)
        (tmp_path / name).write_bytes(whole)


def test_random_bytes_never_escape_as_another_error(tmp_path):
    write_model(scene(), tmp_path)
    rng = np.random.default_rng(1)
    refused = 0
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        whole = np.frombuffer((tmp_path / name).read_bytes(), np.uint8)
        for _ in range(100):
            broken = whole.copy()
            broken[rng.integers(len(broken), size=3)] = rng.integers(256, size=3)
            (tmp_path / name).write_bytes(broken.tobytes())
            try:
                read_model(tmp_path)
            except DataError:
                refused += 1
        (tmp_path / name).write_bytes(whole.tobytes())
    assert refused > 50


def test_unsupported_camera_model_is_named(tmp_path):
    as_text(tmp_path)
    (tmp_path / "cameras.txt").write_text("3 FOV 640 480 1 1 1 1 1\n")
    with pytest.raises(DataError, match="FOV") as caught:
        read_model(tmp_path)
    assert "image_undistorter" in caught.value.hint
    write_model(scene(), tmp_path)
    (tmp_path / "cameras.bin").write_bytes(struct.pack("<QIiQQ", 1, 1, 9, 640, 480) + bytes(40))
    with pytest.raises(DataError, match="number 9"):
        read_model(tmp_path)


@pytest.mark.parametrize("name", ["../a.jpg", "/etc/a.jpg", "x/../../a.jpg", "a\tb.jpg", "C:\\a.jpg"])
def test_names_may_not_leave_the_photo_folder(tmp_path, name):
    write_model(scene(), tmp_path, names=(name, "b", "c", "d"))
    with pytest.raises(DataError, match="inside the photo folder"):
        read_model(tmp_path)


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("images.txt", " 3 a.jpg", " 9 a.jpg"),  # a camera that is not there
        ("images.txt", "b.jpg", "a.jpg"),  # two images of one name
        ("points3D.txt", "\n5 ", "\n6 "),  # two points of one id
        ("cameras.txt", "PINHOLE 640", "PINHOLE 0"),
        ("cameras.txt", "500.0", "nan"),
        ("images.txt", "\n11 ", "\n11 x "),
    ],
)
def test_contradictions_are_refused(tmp_path, file, old, new):
    as_text(tmp_path)
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new))
    with pytest.raises(DataError):
        read_model(tmp_path)


def test_places_a_model_is_found_in(tmp_path):
    assert find_model(tmp_path) is None
    with pytest.raises(DataError, match="no COLMAP model"):
        read_model(tmp_path)
    write_model(scene(), tmp_path / "colmap/sparse/0")
    assert find_model(tmp_path) == tmp_path / "colmap/sparse/0"
    write_model(scene(), tmp_path / "sparse")
    assert find_model(tmp_path) == tmp_path / "sparse"
    scrap = Reconstruction(scene().cameras[:1], ("a.jpg",), np.zeros(1, int), np.eye(3)[None], np.zeros((1, 3)))
    write_model(scrap, tmp_path / "sparse/0")
    assert find_model(tmp_path) == tmp_path / "sparse/0"
    write_model(scene(), tmp_path / "sparse/1")
    assert find_model(tmp_path) == tmp_path / "sparse/1"  # model 0 is a scrap


def test_poses_without_points(tmp_path, shared_data):
    model = read_model(shared_data("kitti_street") / "gt_colmap")
    assert len(model.names) == 51
    assert len(model.points) == 0
    np.testing.assert_allclose(model.centers[1], [-0.01401751, -0.02820321, 1.198998], atol=1e-4)
    both = read_model(shared_data("kitti_street") / "gt_colmap_stereo")
    left, right = both.centers[:51], both.centers[51:]
    np.testing.assert_allclose(np.linalg.norm(right - left, axis=1), 0.537, atol=1e-3)
