"""Rigs told from names and sizes: what is one, what only looks like one, and what the input is then."""

import numpy as np
import pytest

from graphgs.commands import check
from graphgs.options import Options
from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.colmap import write_model
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources import Photos, SourcesConfig, fingerprint, load_photos, scan
from graphgs.sources.rigs import find_rigs
from tests.support.pictures import write_photos


def rigs_of(folders, size=(640, 480)):
    """{folder: [file names]}, all of one size unless the folder's is given as (files, size)."""
    names, sizes = [], []
    for folder, files in folders.items():
        files, own = files if isinstance(files, tuple) else (files, size)
        names += [f"{folder}/{file}" if folder else file for file in files]
        sizes += [own] * len(files)
    order = np.argsort(names)
    return find_rigs(tuple(names[i] for i in order), np.array(sizes)[order])


def numbered(count, first=0, form="{:06d}.png"):
    return [form.format(i) for i in range(first, first + count)]


@pytest.mark.parametrize(
    "folders",
    [
        {"image_0": numbered(10), "image_1": numbered(10)},
        {"images": numbered(10), "images_right": numbered(10)},
        {"FRONT": numbered(10), "FRONT_LEFT": (numbered(10), (640, 300)), "FRONT_RIGHT": numbered(10)},
        {"images/a": numbered(10), "images/b": numbered(10, form="{:06d}.jpg")},
        {"image_02/data": numbered(10), "image_03/data": numbered(10)},
        {"cam0": numbered(10, form="left_{:d}.jpg"), "cam1": numbered(10, form="right_{:04d}.jpg")},
        {"left": numbered(10), "right": numbered(9, first=1)},
    ],
)
def test_sibling_folders_with_the_same_frames(folders):
    (rig,) = rigs_of(folders)
    assert rig.folders == tuple(sorted(folders))
    assert rig.photos.shape == (10, len(folders))
    assert "rig of" in rig.description


def test_frames_pair_what_was_taken_together():
    (rig,) = rigs_of(
        {"left": ["1.jpg", "2.jpg", "3.jpg", "4.jpg", "5.jpg"], "right": ["2.jpg", "3.jpg", "4.jpg", "5.jpg"]}
    )
    assert rig.photos.tolist() == [[0, -1], [1, 5], [2, 6], [3, 7], [4, 8]]
    (rig,) = rigs_of({"a": ["x9.jpg", "x10.jpg", "x11.jpg"], "b": ["y9.jpg", "y10.jpg", "y11.jpg"]})
    assert rig.photos.tolist() == [[2, 5], [0, 3], [1, 4]]  # by number, whatever the order of names


@pytest.mark.parametrize(
    "folders",
    [
        {"": numbered(10)},
        {"only": numbered(10)},
        {"left": numbered(10), "right": numbered(10, first=5)},  # half shared
        {"short": numbered(10), "long": numbered(20)},
        {"left": numbered(2), "right": numbered(2)},
        {"images": numbered(10), "images_2": (numbered(10), (320, 240))},  # a reduced copy
        {"images": numbered(10), "depth": numbered(10)},
        {"rgb": numbered(10), "SemanticLabels": numbered(10)},
        {"train": numbered(10), "val": numbered(10)},
        {"a/left": numbered(10), "b/c/right": numbered(10)},  # no siblings
        {"": numbered(10), "extra": numbered(10)},
        {"a": ["one.jpg", "two.jpg", "three.jpg"], "b": ["four.jpg", "five.jpg", "six.jpg"]},
    ],
)
def test_what_only_looks_like_a_rig(folders):
    assert rigs_of(folders) == ()


def test_two_rigs_and_loose_photos():
    day, night = numbered(10), numbered(30, first=100)
    rigs = rigs_of({"a/left": day, "a/right": day, "b/left": night, "b/right": night, "loose": numbered(9, first=500)})
    assert [rig.folders for rig in rigs] == [("a/left", "a/right"), ("b/left", "b/right")]


def test_photos_of_several_sizes_in_a_folder_are_no_camera():
    names = tuple(f"{folder}/{file}" for folder in ("left", "right") for file in numbered(5))
    sizes = np.full((10, 2), 100)
    sizes[3] = 90
    assert find_rigs(names, sizes) == ()


def load(source, folder, **settings) -> Photos:
    return load_photos(SourcesConfig(**settings), source, folder, reporter=Reporter(), threads=1)


def test_cameras_beside_images_belong_to_the_input(tmp_path):
    source = tmp_path / "in"
    names = write_photos(source / "images", 4, width=96, height=80)
    write_photos(source / "images_right", 4, width=96, height=80)
    write_photos(source / "images_2", 4)
    write_photos(source / "depth", 4)
    photos = load(source, tmp_path / "out")
    assert photos.names == tuple(f"{folder}/{name}" for folder in ("images", "images_right") for name in names)
    assert photos.rigs[0].folders == ("images", "images_right")
    assert "photos in depth/, images_2/ were not used, only those in images/, images_right/" in photos.given_note
    photos.save(tmp_path / "out")
    np.testing.assert_array_equal(Photos.load(tmp_path / "out").rigs[0].photos, photos.rigs[0].photos)
    assert scan(source).rigs[0].folders == photos.rigs[0].folders
    assert any("rig of 2 cameras (images, images_right), 4 frames" in line for line in check(source, Options()))

    plain = load(source, tmp_path / "plain", rigs="off")
    assert plain.names == tuple(names)
    assert plain.rigs == ()
    assert fingerprint(source) != fingerprint(source, rigs=False)


def test_colour_cameras_stand_for_their_grey_twins(tmp_path):
    for camera in range(4):
        write_photos(tmp_path / f"image_{camera}", 3)
    assert load(tmp_path, tmp_path.parent / "out").rigs[0].folders == ("image_2", "image_3")


def test_a_model_of_both_cameras_finds_their_photos(tmp_path):
    for folder in ("images", "images_right"):
        names = write_photos(tmp_path / folder, 3)
    everything = tuple(f"{folder}/{name}" for folder in ("images", "images_right") for name in names)

    def model(of):
        n = len(of)
        return Reconstruction(
            (Camera.pinhole(48, 40, 50, 50, 24, 20),),
            of,
            np.zeros(n, int),
            np.tile(np.eye(3), (n, 1, 1)),
            np.zeros((n, 3)),
        )

    write_model(model(everything), tmp_path / "both")
    write_model(model(tuple(names)), tmp_path / "left")
    assert load(tmp_path / "both", tmp_path / "out").given.names == everything
    assert load(tmp_path / "left", tmp_path / "out").given.names == tuple(names)


def test_a_focal_length_can_be_given(tmp_path):
    write_photos(tmp_path / "in", 3)
    photos = load(tmp_path / "in", tmp_path / "out", decode_max_side=32, focal_px=60.0)
    assert [photo.focal_px for photo in photos.photos] == pytest.approx([40.0] * 3)
