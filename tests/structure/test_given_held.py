"""Given poses are held against the photos: right ones pass without a word, the usual mistakes are refused by name."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources import SourcesConfig, load_photos
from graphgs.structure.config import StructureConfig
from graphgs.structure.given_verdict import HeldPoses
from graphgs.structure.held import hold_given
from graphgs.synth.street import StreetConfig, write_street
from graphgs.workspace import digest
from tests.support.corner_scene import FOCAL, HEIGHT, WIDTH
from tests.support.given_poses import (
    colmap_project,
    kitti_rows,
    transforms_json,
    with_points_moved,
    without_tracks,
    written_as_camera_to_world,
)
from tests.support.hard_scenes import as_photos, house_row


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    config = StreetConfig(frames=12, width=320, height=180, depth=False, points=3000)
    return write_street(config, tmp_path_factory.mktemp("street"))


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """Hold the poses of an input against its photos. The same photos are matched once: what verification makes of a
    pair depends on neither poses nor intrinsics."""
    work = tmp_path_factory.mktemp("held")

    def hold(source, *, poses: str = "keep", **settings) -> HeldPoses:
        sources = SourcesConfig(decode_max_side=640, **settings)
        folder = work / str(len(list(work.iterdir())))
        run = {"reporter": Reporter(), "threads": 1}
        photos = load_photos(sources, source, folder / "photos", **run)
        scratch = work / digest([photo.sha256 for photo in photos.photos])
        return hold_given(StructureConfig(poses=poses), sources, photos, scratch=scratch, **run)

    return hold


def refused(found: HeldPoses) -> DataError:
    assert found.verdict == "refused"
    assert found.refusal().exit_code == 3
    return found.refusal()


@pytest.mark.parametrize(
    "write",
    [
        colmap_project,
        transforms_json,
        kitti_rows,
        lambda street, folder: colmap_project(street, folder, without_tracks(street.reconstruction)),
    ],
    ids=["colmap", "transforms", "kitti", "points without tracks"],
)
def test_right_poses_pass_without_a_word(street, held, tmp_path, write):
    found = held(write(street, tmp_path / "in"))
    assert found.verdict == "fits"
    assert found.cautions == ()
    assert found.refusal() is None
    assert found.matches.contradicted < 0.05
    assert found.matches.median_px < 0.5
    assert HeldPoses.load(saved(found, tmp_path)) == found


def saved(found: HeldPoses, folder):
    found.save(folder / "saved")
    return folder / "saved"


@pytest.mark.parametrize(
    ("mistake", "fits", "mend"),
    [
        ({"axes": "opencv"}, "y and z axes flipped", {"given_axes": "opencv"}),
        ({"intrinsics": 2.0}, "intrinsics of half the size", {"given_scale": 0.5}),
        ({"intrinsics": 0.5}, "intrinsics of twice the size", {"given_scale": 2.0}),
        ({"inverse": True}, "inverted", {"given_inverse": True}),
        ({"inverse": True, "axes": "opencv"}, "inverted", {"given_inverse": True, "given_axes": "opencv"}),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else None,
)
def test_mistakes_in_a_transforms_json_are_named_and_mended(street, held, tmp_path, mistake, fits, mend):
    source = transforms_json(street, tmp_path / "in", **mistake)
    error = refused(held(source))
    assert fits in error.message
    for name, value in mend.items():
        option = f"--given-axes {value}" if name == "given_axes" else f"sources.{name}={str(value).lower()}"
        assert option.removesuffix(".0") in error.hint
    assert held(source, **mend).verdict == "fits"


@pytest.mark.parametrize(
    ("mistake", "order"),
    [({"padded": False}, "number"), ({"rows_as_text": True}, "text")],
    ids=["photos sorted 1, 10, 11, 2", "rows sorted 1, 10, 11, 2"],
)
def test_rows_in_another_order_than_the_photos(street, held, tmp_path, mistake, order):
    source = kitti_rows(street, tmp_path / "in", **mistake)
    error = refused(held(source))
    assert "by the numbers in the photos' names" in error.message
    assert f"sources.given_order={order}" in error.hint
    assert held(source, given_order=order).verdict == "fits"


def test_a_model_that_holds_camera_to_world(street, held, tmp_path):
    source = colmap_project(street, tmp_path / "in", written_as_camera_to_world(street.reconstruction))
    assert "they fit inverted" in refused(held(source)).message
    assert held(source, given_inverse=True).poses == "fits"


@pytest.mark.parametrize("tracks", [True, False])
def test_points_in_another_frame_than_the_cameras(street, held, tmp_path, tracks):
    model = with_points_moved(street.reconstruction)
    source = colmap_project(street, tmp_path / "in", model if tracks else without_tracks(model))
    found = held(source)
    assert (found.poses, found.points) == ("fits", "refused")
    error = refused(found)
    assert "the poses do fit, so the points are in another frame" in error.message
    assert "sources.given_points=drop" in error.hint
    assert held(source, given_points="drop").verdict == "fits"
    assert held(source, poses="refine").verdict == "fits"  # points are triangulated anew


def test_a_setting_that_makes_right_poses_wrong_is_what_is_named(street, held, tmp_path):
    source = transforms_json(street, tmp_path / "in")
    assert "--given-axes opengl" in refused(held(source, given_axes="opencv")).hint
    assert "given_inverse=false" in refused(held(source, given_inverse=True)).hint
    source = kitti_rows(street, tmp_path / "rows")
    assert "given_order=name" in refused(held(source, given_order="text")).hint


def test_poses_of_other_photos_fit_no_way(street, held, tmp_path):
    model = street.reconstruction
    shuffled = np.random.default_rng(3).permutation(len(model.names))
    wrong = dataclasses.replace(
        without_tracks(model), rotations=model.rotations[shuffled], translations=model.translations[shuffled]
    )
    error = refused(held(colmap_project(street, tmp_path / "in", wrong)))
    assert "they fit" not in error.message
    assert "--poses prior" in error.hint


def turned(model, degrees: float):
    """Every camera turned on the spot, each another way."""
    away = np.radians(degrees) * np.random.default_rng(5).normal(size=(len(model.names), 3)) / np.sqrt(3)
    rotations = Rotation.from_rotvec(away).as_matrix() @ model.rotations
    translations = -np.einsum("nij,nj->ni", rotations, model.centers)
    return dataclasses.replace(without_tracks(model), rotations=rotations, translations=translations)


def test_poses_that_are_nearly_right_are_used_with_a_caution_or_refined(street, held, tmp_path):
    source = colmap_project(street, tmp_path / "a bit", turned(street.reconstruction, 0.3))
    found = held(source)
    assert found.verdict == "doubtful"
    assert found.refusal() is None
    assert "do not quite fit" in found.cautions[0]
    assert " px off in the median" in found.cautions[0]
    assert "--poses refine" in found.cautions[0]

    source = colmap_project(street, tmp_path / "more", turned(street.reconstruction, 0.6))
    assert "--poses refine" in refused(held(source)).hint
    near = held(source, poses="refine")
    assert near.verdict == "fits"
    assert near.cautions == ()


def test_right_poses_among_alike_houses_are_not_refused(tmp_path):
    """Two thirds of the matches are between houses that look alike; but every photo fits its neighbours."""
    shots = house_row(houses=4, gap=2.0, count=24)
    photos = as_photos(tmp_path / "photos", shots.images)

    def held(rotations: np.ndarray, centers: np.ndarray) -> HeldPoses:
        given = Reconstruction(
            cameras=(Camera.pinhole(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2),),
            names=photos.names,
            camera_ids=np.zeros(len(photos.names), np.int64),
            rotations=rotations,
            translations=-np.einsum("nij,nj->ni", rotations, centers),
        )
        run = {"scratch": tmp_path / "held", "reporter": Reporter(), "threads": 1}
        return hold_given(StructureConfig(), SourcesConfig(), dataclasses.replace(photos, given=given), **run)

    right = held(shots.rotations, shots.centers)
    assert right.matches.contradicted > 0.5
    assert right.verdict == "doubtful"
    assert "parts of the scene look alike" in right.cautions[0]
    flipped = held(np.diag([1.0, -1.0, -1.0]) @ shots.rotations, shots.centers)
    assert "y and z axes flipped" in refused(flipped).message
    shuffled = np.random.default_rng(0).permutation(len(photos.names))
    assert "they fit" not in refused(held(shots.rotations[shuffled], shots.centers[shuffled])).message


def test_wrong_axes_are_named_before_poses_are_refined(street, held, tmp_path):
    error = refused(held(transforms_json(street, tmp_path / "in", axes="opencv"), poses="refine"))
    assert "--given-axes opencv" in error.hint


@pytest.mark.parametrize("model", ["fountain/gt_colmap", "castle/gt_colmap", "kitti_street/gt_colmap"])
def test_true_poses_of_real_photos_pass(shared_data, held, model):
    name, _, place = model.partition("/")
    found = held(shared_data(name) / place)
    assert found.verdict == "fits"
    assert found.matches.count > 5000


def test_pseudo_truth_with_an_off_centre_lens_passes(shared_data, held):
    assert held(shared_data("fox") / "transforms.json").verdict == "fits"
    assert "y and z axes flipped" in refused(held(shared_data("fox") / "transforms.json", given_axes="opencv")).message


def test_a_straight_drive_shows_permuted_and_reversed_poses(shared_data, held):
    """Where each pair for itself would nearly fit."""
    source = shared_data("kitti_street") / "poses.txt"
    assert "given_order=name" in refused(held(source, given_order="text")).hint
    assert "given_inverse=false" in refused(held(source, given_inverse=True)).hint
    assert "given_scale=1" in refused(held(source, given_scale=2.0)).hint
