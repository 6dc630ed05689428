"""Poses an input carries or a user offers: axes, names, sizes, and files that are not to be trusted."""

import json
import math

import cv2
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from graphgs.errors import DataError, UsageError
from graphgs.progress import Reporter
from graphgs.scene.camera import MODEL_PARAMS, Camera
from graphgs.scene.colmap import read_model, write_model
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import align, diameter
from graphgs.sources import Photos, SourcesConfig, load_photos, read_poses, scan
from graphgs.sources.given import match_names, turned
from graphgs.sources.transforms import read_transforms
from tests.support.pictures import picture, write_photos

NAMES = ("0000.png", "0001.png", "0002.png", "0003.png")


def load(source, folder, *, side=1600) -> Photos:
    return load_photos(SourcesConfig(side), source, folder, reporter=Reporter(), threads=2)


def posed(names=NAMES, *, camera: Camera | None = None, seed: int = 0) -> Reconstruction:
    """A pose per name and two points, each seen where the first and the last image see them."""
    rng = np.random.default_rng(seed)
    n = len(names)
    rotations = Rotation.from_rotvec(rng.normal(scale=0.1, size=(n, 3))).as_matrix()
    poses = Reconstruction(
        cameras=(camera or Camera.pinhole(48, 40, 50, 52, 25, 19),),
        names=tuple(names),
        camera_ids=np.zeros(n, int),
        rotations=rotations,
        translations=rng.normal(scale=0.1, size=(n, 3)),
        points=np.array([[0.1, -0.2, 3.0], [-0.3, 0.2, 2.5]]),
        colors=np.full((2, 3), 128, np.uint8),
        errors=np.ones(2),
        track_offsets=np.array([0, 2, 4]),
        track_images=np.array([0, n - 1, 0, n - 1], np.int32),
    )
    seen = [project(poses, i, poses.points[p]) for p in range(2) for i in (0, n - 1)]
    return Reconstruction(**{**poses.__dict__, "track_xy": np.array(seen)})


def project(poses: Reconstruction, i: int, point: np.ndarray) -> np.ndarray:
    """[2] px by OpenCV, distortion and all."""
    camera = poses.camera_of(i)
    vector = Rotation.from_matrix(poses.rotations[i]).as_rotvec()
    model = cv2.fisheye.projectPoints if camera.is_fisheye else cv2.projectPoints
    return model(point[None, None], vector, poses.translations[i], camera.K, camera.distortion)[0].reshape(2)


def assert_tracks_fit(poses: Reconstruction) -> None:
    for p in range(len(poses.points)):
        for t in range(poses.track_offsets[p], poses.track_offsets[p + 1]):
            expected = project(poses, poses.track_images[t], poses.points[p])
            np.testing.assert_allclose(poses.track_xy[t], expected, atol=1e-6)


def frame(name: str, matrix=None, **fields) -> dict:
    return {"file_path": name, "transform_matrix": (np.eye(4) if matrix is None else matrix).tolist(), **fields}


def write_transforms(folder, frames: list, **fields):
    file = folder / "transforms.json"
    file.write_text(json.dumps({"fl_x": 50.0, "frames": frames} | fields))
    return file


# ---------------------------------------------------------------- which input is what


def test_poses_beside_photos_are_named_not_used(tmp_path):
    names = write_photos(tmp_path / "images", 3)
    write_photos(tmp_path / "more", 3)
    write_transforms(tmp_path, [frame(f"images/{name}") for name in names])
    write_model(posed(names), tmp_path / "gt_colmap")
    photos = load(tmp_path, tmp_path.parent / "out")
    assert photos.given is None
    assert photos.names == tuple(names)
    assert "transforms.json lies beside the photos and was not used; give it as INPUT" in photos.given_note
    assert "gt_colmap holds camera poses and was not used" in photos.given_note
    assert "photos in more/ were not used" in photos.given_note


def test_a_colmap_project_keeps_its_poses(tmp_path):
    names = write_photos(tmp_path / "images", 4)
    write_model(posed(names), tmp_path / "sparse/0")
    photos = load(tmp_path, tmp_path / "out", side=24)
    assert scan(tmp_path).kind == "colmap"
    assert photos.given.names == photos.names == tuple(names)
    assert photos.given.cameras == (Camera.pinhole(24, 20, 25, 26, 12.5, 9.5),)
    assert len(photos.given.points) == 2
    assert_tracks_fit(photos.given)
    photos.save(tmp_path / "out")
    assert Photos.load(tmp_path / "out").given.cameras == photos.given.cameras


def test_a_model_by_itself_finds_its_photos(tmp_path):
    names = write_photos(tmp_path / "images", 3)
    write_model(posed(names), tmp_path / "gt_colmap")
    assert load(tmp_path / "gt_colmap", tmp_path / "out").given.names == tuple(names)
    write_model(posed(names), tmp_path / "alone/model")
    (tmp_path / "images").rename(tmp_path / "pictures")
    with pytest.raises(DataError, match="without photos"):
        load(tmp_path / "alone/model", tmp_path / "out")


def test_unposed_and_unreadable_photos_of_a_project(tmp_path):
    names = write_photos(tmp_path / "images", 5)
    write_model(posed((names[0], names[1], names[3], "gone.png")), tmp_path / "sparse/0")
    (tmp_path / "images" / names[1]).write_text("words")
    photos = load(tmp_path, tmp_path / "out")
    assert photos.names == (names[0], names[2], names[3], names[4])
    assert photos.given.names == (names[0], names[3])
    assert photos.given.track_lengths.tolist() == [1, 1]  # what the image that is gone saw is gone
    assert_tracks_fit(photos.given)


# ---------------------------------------------------------------- names and sizes


def test_names_match_exactly_or_but_for_one_folder():
    assert match_names(("a.jpg", "b.jpg"), ("b.jpg", "c.jpg")) == {"b.jpg": 1}
    assert match_names(("images/a.jpg", "images/b.jpg"), ("b.jpg",)) == {"b.jpg": 1}
    assert match_names(("a.jpg", "b.jpg"), ("photos/b.jpg", "photos/a.jpg")) == {"photos/b.jpg": 1, "photos/a.jpg": 0}
    assert match_names(("x/a.jpg",), ("y/a.jpg",)) == {}
    with pytest.raises(DataError, match=r"under two folders alike: left/ or right/"):
        match_names(("left/a.jpg", "right/a.jpg"), ("a.jpg",))


def test_sizes_that_contradict_each_other(tmp_path):
    names = write_photos(tmp_path / "images", 3)
    write_model(posed(names, camera=Camera.pinhole(64, 40, 50, 50, 32, 20)), tmp_path / "sparse/0")
    with pytest.raises(DataError, match="64x40 px, the photo 48x40"):
        load(tmp_path, tmp_path / "out")
    write_model(posed(("x.png", "y.png", "z.png")), tmp_path / "sparse/0")
    with pytest.raises(DataError, match="names a photo"):
        load(tmp_path, tmp_path / "out")


@pytest.mark.parametrize("model", MODEL_PARAMS)
def test_a_turned_camera_sees_the_turned_picture(model):
    one_focal = model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
    params = [50.0, 25.0, 19.0] if one_focal else [50.0, 52.0, 25.0, 19.0]
    params += [0.05, -0.02, 0.013, -0.007, 0.01, 0.002, 0.001, 0.003][: MODEL_PARAMS[model] - len(params)]
    camera = Camera(model, 48, 40, tuple(params))
    ray, ray_turned = np.array([0.3, -0.2, 1.0]), np.array([0.2, 0.3, 1.0])  # x' = -y, y' = x
    still = [
        Reconstruction((c,), ("a",), np.zeros(1, int), np.eye(3)[None], np.zeros((1, 3)))
        for c in (camera, turned(camera))
    ]
    x, y = project(still[0], 0, ray)
    np.testing.assert_allclose(project(still[1], 0, ray_turned), [40 - y, x], atol=1e-9)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_poses_of_the_stored_pixels_turn_with_the_photo(tmp_path, orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    (tmp_path / "images").mkdir()
    for i, name in enumerate(NAMES):
        Image.fromarray(picture(i)).save(tmp_path / "images" / name, exif=exif)
    camera = Camera("OPENCV", 48, 40, (50, 52, 25, 19, 0.05, -0.02, 0.013, -0.007))
    stored = posed(NAMES, camera=camera)
    write_model(stored, tmp_path / "sparse/0")
    upright = load(tmp_path, tmp_path / "out", side=24).given
    assert_tracks_fit(upright)
    np.testing.assert_allclose(upright.centers, stored.centers, atol=1e-9)
    x, y = stored.track_xy[0] / 2
    expected = {1: (x, y), 3: (24 - x, 20 - y), 6: (20 - y, x), 8: (y, 24 - x)}[orientation]
    np.testing.assert_allclose(upright.track_xy[0], expected, atol=1e-6)


def test_poses_of_upright_pixels_stay_and_mirrored_ones_are_refused(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    (tmp_path / "images").mkdir()
    for i, name in enumerate(NAMES):
        Image.fromarray(picture(i)).save(tmp_path / "images" / name, exif=exif)
    upright = posed(NAMES, camera=Camera.pinhole(40, 48, 50, 52, 19, 25))
    write_model(upright, tmp_path / "sparse/0")
    given = load(tmp_path, tmp_path / "out").given
    np.testing.assert_allclose(given.rotations, upright.rotations, atol=1e-9)
    exif[0x0112] = 2
    for i, name in enumerate(NAMES):
        Image.fromarray(picture(i)).save(tmp_path / "images" / name, exif=exif)
    write_model(posed(NAMES), tmp_path / "sparse/0")
    with pytest.raises(DataError, match="mirrored"):
        load(tmp_path, tmp_path / "out")


# ---------------------------------------------------------------- transforms.json


def test_opengl_axes(tmp_path):
    """A camera at (1, 2, 3) with OpenGL axes parallel to the world's looks along -z, with +y up."""
    names = write_photos(tmp_path, 3)
    matrix = np.eye(4)
    matrix[:3, 3] = (1, 2, 3)
    file = write_transforms(tmp_path, [frame(name, matrix) for name in names], cx=20.0, cy=18.0, w=48, h=40)
    given = load(file, tmp_path / "out").given
    np.testing.assert_allclose(given.centers, [[1, 2, 3]] * 3)
    right_up_ahead = np.array([1 + 0.2, 2 + 0.1, 3 - 2.0])
    np.testing.assert_allclose(project(given, 0, right_up_ahead), [20 + 50 * 0.1, 18 - 50 * 0.05], atol=1e-9)


def test_intrinsics_in_all_their_spellings(tmp_path):
    write_photos(tmp_path, 4)
    frames = [
        frame("./0000.png", camera_angle_x=math.pi / 2),
        frame("0001", fl_x=40, fl_y=41, k1=0.1, p2=0.01),  # without its ending
        frame(str(tmp_path / "0002.png"), camera_model="OPENCV_FISHEYE", k4=0.2, cx=20),
        frame("0003.png", w=96, h=80, fl_x=100, k3=0.3),
    ]
    file = tmp_path / "transforms.json"
    file.write_text(json.dumps({"camera_angle_x": 1.0, "frames": frames}))
    cameras = [read_transforms(file).frames[i].camera(48, 40) for i in range(4)]
    assert cameras[0].model == "PINHOLE"
    np.testing.assert_allclose(cameras[0].params, (24, 24, 24, 20))
    assert cameras[1] == Camera("OPENCV", 48, 40, (40, 41, 24, 20, 0.1, 0, 0, 0.01))
    assert cameras[2].model == "OPENCV_FISHEYE"
    assert cameras[2].params[2:] == (20, 20, 0, 0, 0, 0.2)
    assert cameras[3].model == "FULL_OPENCV"
    given = load(file, tmp_path / "out").given
    assert given.names == NAMES
    assert given.camera_of(3).params[:2] == (50, 50)  # stated for twice the size
    assert {(c.width, c.height) for c in given.cameras} == {(48, 40)}


def test_frames_choose_the_photos_and_their_masks(tmp_path):
    names = write_photos(tmp_path / "images", 5)
    (tmp_path / "drawn").mkdir()
    Image.fromarray(np.tile(np.uint8([[0, 255]]), (40, 24))).save(tmp_path / "drawn/2.png")
    frames = [frame(f"images/{name}") for name in names[:4]]
    frames[2]["mask_path"] = "drawn/2.png"
    file = write_transforms(tmp_path, [*frames, frame("images/none.png")])
    photos = load(file, tmp_path / "out")
    assert photos.names == photos.given.names == tuple(names[:4])  # named as the folder's photos are
    assert [photo.mask is not None for photo in photos.photos] == [False, False, True, False]
    assert [skipped.name for skipped in photos.skipped] == ["none.png"]


@pytest.mark.parametrize("name", ["../x.png", "/etc/passwd", "a/../../x.png", "C:\\x.png", "", 7, None, "x\0.png"])
def test_names_may_not_leave_the_data_folder(tmp_path, name):
    write_photos(tmp_path, 1, first=9)
    write_photos(tmp_path / "data", 3)
    file = write_transforms(tmp_path / "data", [frame("0000.png"), frame("0001.png") | {"file_path": name}])
    with pytest.raises(DataError, match=r"frame 1: .*(data folder|is not text)"):
        load(file, tmp_path / "out")
    masked = [frame("0000.png"), frame("0001.png", mask_path="../0009.png")]
    with pytest.raises(DataError, match="data folder"):
        load(write_transforms(tmp_path / "data", masked), tmp_path / "out")


@pytest.mark.parametrize(
    "content",
    [
        "words",
        "[]",
        "{}",
        '{"frames": []}',
        '{"frames": [7]}',
        '{"frames": [{"file_path": "0000.png"}]}',
        '{"frames": [{"file_path": "0000.png", "transform_matrix": [[1]]}]}',
        '{"frames": [{"file_path": "0000.png", "transform_matrix": [[0,0,0,0],[0,0,0,0],[0,0,0,0]]}]}',
        json.dumps({"fl_x": 1, "frames": [frame("0000.png", np.diag([1.0, 1, -1, 1]))]}),
        json.dumps({"fl_x": 1, "frames": [frame("0000.png", np.diag([1.0, 1, 9, 1]))]}),
        json.dumps({"fl_x": 1, "frames": [frame("0000.png", np.full((4, 4), np.nan))]}),
        json.dumps({"fl_x": math.inf, "frames": [frame("0000.png")]}),
        json.dumps({"fl_x": "wide", "frames": [frame("0000.png")]}),
        json.dumps({"fl_x": -5, "frames": [frame("0000.png")]}),
        json.dumps({"camera_angle_x": 4, "frames": [frame("0000.png")]}),
        json.dumps({"frames": [frame("0000.png")]}),
        json.dumps({"fl_x": 1, "camera_model": "EQUIRECTANGULAR", "frames": [frame("0000.png")]}),
        json.dumps({"fl_x": 1, "frames": [frame("0000.png"), frame("./0000.png")]}),
        "[" * 100000,
    ],
)
def test_broken_transforms_are_named(tmp_path, content):
    write_photos(tmp_path, 3)
    file = tmp_path / "transforms.json"
    file.write_text(content)
    with pytest.raises(DataError, match=r"transforms\.json") as caught:
        load(file, tmp_path / "out")
    assert "\n" not in caught.value.message
    assert caught.value.hint


def test_fox(shared_data):
    file = shared_data("fox") / "transforms.json"
    seen = scan(file)
    assert (seen.kind, len(seen.names), seen.names[0]) == ("transforms", 50, "0001.jpg")
    poses = read_transforms(file).reconstruction(lambda name: (1080, 1920))
    assert poses.cameras[0].model == "OPENCV"
    # All cameras look at the fox: their optical axes nearly meet in one point, in front of each of them.
    ahead, centers = poses.rotations[:, 2], poses.centers
    off_axis = np.eye(3) - ahead[:, :, None] * ahead[:, None]
    meeting = np.linalg.solve(off_axis.sum(0), np.einsum("nij,nj->i", off_axis, centers))
    assert (np.einsum("ni,ni->n", meeting - centers, ahead) > 0).all()
    miss = np.linalg.norm(np.einsum("nij,nj->ni", off_axis, meeting - centers), axis=1)
    assert np.median(miss) < 0.2 * diameter(centers)
    assert (poses.rotations[:, 1] @ [0, 0, 1] < 0).mean() > 0.9  # instant-ngp's world has +z up, our y looks down


# ---------------------------------------------------------------- rows of numbers


def write_kitti(folder, poses: Reconstruction, *, shift: float = 0.0):
    """poses.txt and calib.txt; camera 1 sits `shift` to the right of camera 0."""
    inverse = np.linalg.inv(poses.viewmats)[:, :3]
    np.savetxt(folder / "poses.txt", inverse.reshape(-1, 12))
    left = np.array([[50, 0, 24, 0], [0, 50, 20, 0], [0, 0, 1, 0.0]])
    right = left.copy()
    right[0, 3] = -50 * shift
    lines = [f"P{i}: " + " ".join(map(str, p.ravel())) for i, p in enumerate((left, right))]
    (folder / "calib.txt").write_text("\n".join(lines) + "\nTr: " + "0 " * 12 + "\n")


def test_kitti_sequence(tmp_path):
    names = write_photos(tmp_path / "image_0", 4)
    write_kitti(tmp_path, posed(names))
    (tmp_path / "image_0" / names[1]).write_text("words")  # rows still belong to the files in order
    folder = load(tmp_path, tmp_path / "out")
    assert folder.given is None
    assert "--set sources.focal_px=50.0 uses it" in folder.given_note
    photos = load(tmp_path / "poses.txt", tmp_path / "out")
    assert photos.given.names == (names[0], names[2], names[3])
    np.testing.assert_allclose(photos.given.centers, posed(names).centers[[0, 2, 3]], atol=1e-9)
    np.testing.assert_allclose(photos.given.cameras[0].K, [[50, 0, 24], [0, 50, 20], [0, 0, 1]])


def test_kitti_poses_of_another_camera(tmp_path):
    names = write_photos(tmp_path / "image_1", 4)
    (tmp_path / "image_1").rename(tmp_path / "images")
    write_kitti(tmp_path, posed(names), shift=0.5)
    left = load(tmp_path / "poses.txt", tmp_path / "out").given
    (tmp_path / "images").rename(tmp_path / "image_2")
    (tmp_path / "calib.txt").write_text(
        (tmp_path / "calib.txt").read_text().replace("P1:", "P1: " + "1 " * 12 + "\nP2:")
    )
    right = load(tmp_path / "poses.txt", tmp_path / "out").given
    np.testing.assert_allclose(right.centers, left.centers + 0.5 * left.rotations[:, 0], atol=1e-9)


def test_kitti_without_its_files(tmp_path):
    names = write_photos(tmp_path / "images", 4)
    write_kitti(tmp_path, posed(names))
    write_photos(tmp_path / "images", 1, first=7)
    with pytest.raises(DataError, match="4 poses for 5 photos"):
        load(tmp_path / "poses.txt", tmp_path / "out")
    (tmp_path / "images/0007.png").unlink()
    (tmp_path / "calib.txt").unlink()
    with pytest.raises(DataError, match=r"calib\.txt"):
        load(tmp_path / "poses.txt", tmp_path / "out")


def test_kitti_street_agrees_with_its_colmap_model(tmp_path, shared_data):
    folder = shared_data("kitti_street")
    photos = load(folder / "poses.txt", tmp_path / "out", side=320)
    truth = read_model(folder / "gt_colmap")
    assert photos.given.names == truth.names
    np.testing.assert_allclose(photos.given.centers, truth.centers, atol=1e-4)
    np.testing.assert_allclose(photos.given.rotations, truth.rotations, atol=1e-5)
    assert photos.given.cameras[0].params[0] == pytest.approx(707.0912 * 320 / 1226)
    names, rotations, centers = read_poses(folder / "gt_colmap", photos)
    assert names == truth.names
    np.testing.assert_allclose(centers, truth.centers)
    names, rotations, centers = read_poses(folder / "poses.txt", photos)
    assert names == truth.names
    np.testing.assert_allclose(rotations, truth.rotations, atol=1e-5)


# ---------------------------------------------------------------- priors


@pytest.fixture
def photos(tmp_path) -> Photos:
    write_photos(tmp_path / "images", 4)
    return load(tmp_path / "images", tmp_path / "out")


def test_prior_from_every_kind_of_file(tmp_path, photos):
    truth = posed()
    inverse = np.linalg.inv(truth.viewmats)
    write_model(truth, tmp_path / "model", names=tuple(f"images/{name}" for name in NAMES))
    opengl = inverse @ np.diag([1.0, -1, -1, 1])
    write_transforms(tmp_path, [frame(f"images/{n}", m) for n, m in zip(NAMES, opengl, strict=True)])
    write_kitti(tmp_path, truth)
    quats = Rotation.from_matrix(inverse[:, :3, :3]).as_quat()
    np.savetxt(tmp_path / "tum.txt", np.c_[np.arange(4.0), inverse[:, :3, 3], quats], header="timestamp tx ty tz")
    for file in ("model", "transforms.json", "poses.txt", "tum.txt"):
        names, rotations, centers = read_poses(tmp_path / file, photos)
        assert names == NAMES
        np.testing.assert_allclose(rotations, truth.rotations, atol=1e-9, err_msg=file)
        np.testing.assert_allclose(centers, truth.centers, atol=1e-9, err_msg=file)


def test_tum_poses_by_time(tmp_path):
    (tmp_path / "in").mkdir()
    for i, name in enumerate(("10.000.png", "10.100.png", "10.205.png", "99.0.png")):
        Image.fromarray(picture(i)).save(tmp_path / "in" / name)
    photos = load(tmp_path / "in", tmp_path / "out")
    times = 9.9 + 0.1 * np.arange(10)
    np.savetxt(tmp_path / "tum.txt", np.c_[times, times, np.zeros((10, 5)), np.ones(10)])
    names, rotations, centers = read_poses(tmp_path / "tum.txt", photos)
    assert names == ("10.000.png", "10.100.png", "10.205.png")  # none is near 99 s
    np.testing.assert_allclose(centers[:, 0], [10.0, 10.1, 10.2])
    np.testing.assert_allclose(rotations, np.tile(np.eye(3), (3, 1, 1)))


def test_priors_that_cannot_be_used(tmp_path, photos):
    with pytest.raises(UsageError, match="does not exist"):
        read_poses(tmp_path / "none.txt", photos)
    write_model(posed(NAMES[:2]), tmp_path / "model")
    with pytest.raises(DataError, match="poses for 2 of the 4 photos"):
        read_poses(tmp_path / "model", photos)
    for content in ("words", "1 2 3", "nan " * 12, "0 " * 12 + "\n" + "0 " * 11, "0 " * 12, "0 " * 8, ""):
        (tmp_path / "bad.txt").write_text(content)
        with pytest.raises(DataError):
            read_poses(tmp_path / "bad.txt", photos)
    write_kitti(tmp_path, posed([*NAMES, "4.png", "5.png"]))
    with pytest.raises(DataError, match="6 poses for 4 photos"):
        read_poses(tmp_path / "poses.txt", photos)


def test_prior_of_real_photos(tmp_path, shared_data):
    """fox's poses through read_poses are those of the file, whichever way the photos were given."""
    source = tmp_path / "fox"
    source.mkdir()
    for path in sorted((shared_data("fox") / "images").iterdir())[:4]:
        (source / path.name).symlink_to(path)
    photos = load(source, tmp_path / "out", side=200)
    names, _, centers = read_poses(shared_data("fox") / "transforms.json", photos)
    assert names == photos.names
    all_poses = read_transforms(shared_data("fox") / "transforms.json").reconstruction(lambda name: (1080, 1920))
    np.testing.assert_allclose(centers, all_poses.centers[: len(names)])
    assert align(centers, all_poses.centers[: len(names)]).scale == pytest.approx(1)
