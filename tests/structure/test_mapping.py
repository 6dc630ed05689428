"""From photos to poses on a rendered corner of a room with known cameras, and what bad photos lead to."""

import dataclasses
import shutil

import cv2
import numpy as np
import pytest

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import align, diameter
from graphgs.structure.candidates import candidate_pairs
from graphgs.structure.coarse import coarse_poses
from graphgs.structure.config import StructureConfig
from graphgs.structure.given import keep_given, map_given, needs_matching
from graphgs.structure.mapping import map_fine
from graphgs.structure.matching import Matches, match_pairs
from graphgs.structure.pairing_config import PairingConfig
from graphgs.structure.prior import Prior
from graphgs.structure.priors import given_prior, own_prior, sequence_prior
from graphgs.structure.result import Structure
from tests.support.corner_scene import FOCAL, HEIGHT, WIDTH, corner_scene

CONFIG = StructureConfig()
ONE_THREAD = {"reporter": Reporter(), "threads": 1, "seed": 0}


def match_all(config, photos, prior, scratch):
    pairs = candidate_pairs(PairingConfig(), prior, reporter=Reporter(), threads=1)
    return match_pairs(config, photos, pairs, prior, scratch=scratch, **ONE_THREAD)


@pytest.fixture(scope="module")
def corner(tmp_path_factory):
    return corner_scene(tmp_path_factory.mktemp("corner"))


@pytest.fixture(scope="module")
def solved(corner, tmp_path_factory):
    """(prior, matches, structure, scratch) of the corner on one thread."""
    scratch = tmp_path_factory.mktemp("solved")
    prior = coarse_poses(CONFIG, corner.photos, scratch=scratch / "coarse", **ONE_THREAD)
    matches = match_all(CONFIG, corner.photos, prior, scratch / "match")
    structure = map_fine(CONFIG, corner.photos, matches, prior, scratch=scratch / "map", **ONE_THREAD)
    return prior, matches, structure, scratch


def position_errors(reconstruction, corner):
    """[N] % of the scene."""
    moved = align(reconstruction.centers, corner.centers).apply(reconstruction.centers)
    return 100 * np.linalg.norm(moved - corner.centers, axis=1) / diameter(corner.centers)


def test_all_photos_get_accurate_poses(corner, solved):
    prior, _, structure, _ = solved
    assert prior.placed.all()
    assert structure.accepted
    assert structure.status == "ok"
    assert structure.unregistered == ()
    reconstruction = structure.reconstruction
    assert reconstruction.names == corner.photos.names
    # 320 px wide photos: 0.2 px of noise over 260 px of focal length at 5 m, on a scene of 1.6 m
    assert np.median(position_errors(reconstruction, corner)) < 0.5
    camera = reconstruction.cameras[0]
    assert camera.params[0] == pytest.approx(FOCAL, rel=0.04)
    assert structure.agreement.within(CONFIG)


def test_tracks_project_where_they_were_seen(solved):
    reconstruction = solved[2].reconstruction
    point = np.repeat(np.arange(len(reconstruction.points)), reconstruction.track_lengths)
    image = reconstruction.track_images
    in_camera = np.einsum("tij,tj->ti", reconstruction.rotations[image], reconstruction.points[point])
    in_camera += reconstruction.translations[image]
    camera = reconstruction.cameras[0]
    seen, _ = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), camera.K, camera.distortion)
    error = np.linalg.norm(seen[:, 0] - reconstruction.track_xy, axis=1)
    assert error.max() < CONFIG.max_error_px + 1e-6
    assert np.median(error) < 0.5
    mean = np.add.reduceat(error, reconstruction.track_offsets[:-1]) / reconstruction.track_lengths
    np.testing.assert_allclose(mean, reconstruction.errors, atol=1e-3)


def test_point_colors_are_those_of_the_photos(corner, solved):
    reconstruction = solved[2].reconstruction
    first = cv2.imread(str(corner.photos.folder / corner.photos.photos[0].pixels))[..., ::-1]
    rows = np.flatnonzero(reconstruction.track_images == 0)
    point = np.repeat(np.arange(len(reconstruction.points)), reconstruction.track_lengths)[rows]
    x, y = reconstruction.track_xy[rows].astype(int).T
    difference = np.abs(reconstruction.colors[point].astype(int) - first[y, x]).mean()
    swapped = np.abs(reconstruction.colors[point].astype(int) - first[y, x, ::-1]).mean()
    assert difference < 25
    assert difference < 0.5 * swapped


def test_one_thread_repeats_to_the_last_bit(corner, solved, tmp_path):
    prior = coarse_poses(CONFIG, corner.photos, scratch=tmp_path / "coarse", **ONE_THREAD)
    matches = match_all(CONFIG, corner.photos, prior, tmp_path / "match")
    again = map_fine(CONFIG, corner.photos, matches, prior, scratch=tmp_path / "map", **ONE_THREAD)
    for field in dataclasses.fields(Reconstruction):
        first = getattr(solved[2].reconstruction, field.name)
        second = getattr(again.reconstruction, field.name)
        if isinstance(first, np.ndarray):
            assert first.tobytes() == second.tobytes(), field.name
        else:
            assert first == second


def test_artefacts_survive_saving(solved, tmp_path):
    prior, matches, structure, _ = solved
    prior.save(tmp_path / "prior")
    matches.save(tmp_path / "matches")
    structure.save(tmp_path / "structure")
    loaded = Prior.load(tmp_path / "prior")
    np.testing.assert_array_equal(loaded.centers, prior.centers)
    assert loaded.cameras.cameras == prior.cameras.cameras
    assert loaded.reconstruction.names == prior.reconstruction.names
    assert Matches.load(tmp_path / "matches").database.is_file()
    np.testing.assert_array_equal(Matches.load(tmp_path / "matches").edges, matches.edges)
    assert Structure.load(tmp_path / "structure").agreement == structure.agreement
    np.testing.assert_array_equal(Structure.load(tmp_path / "structure").edges, structure.edges)
    kept = Structure.load(tmp_path / "structure").diagnosis
    assert kept.soundness == structure.diagnosis.soundness
    assert Structure.load(tmp_path / "structure").grouping == structure.grouping
    np.testing.assert_array_equal(kept.error_px, structure.diagnosis.error_px)
    np.testing.assert_array_equal(kept.tried.pairs, structure.diagnosis.tried.pairs)
    np.testing.assert_array_equal(kept.support.supported, structure.diagnosis.support.supported)


def test_a_mapping_call_in_scratch_is_not_repeated(corner, solved):
    prior, matches, structure, scratch = solved

    class NoMapping(Reporter):
        def progress(self, done, total, note=""):
            raise AssertionError(f"{note} ran again")

    again = map_fine(
        CONFIG, corner.photos, matches, prior, scratch=scratch / "map", reporter=NoMapping(), threads=1, seed=0
    )
    assert again.reconstruction.points.tobytes() == structure.reconstruction.points.tobytes()


def test_photos_the_coarse_step_missed_are_added(corner, solved, tmp_path):
    prior, matches, _, _ = solved
    own = prior.reconstruction
    fewer = dataclasses.replace(
        own,
        names=own.names[:-1],
        camera_ids=own.camera_ids[:-1],
        rotations=own.rotations[:-1],
        translations=own.translations[:-1],
    )
    lacking = dataclasses.replace(prior, reconstruction=fewer)
    structure = map_fine(CONFIG, corner.photos, matches, lacking, scratch=tmp_path, **ONE_THREAD)
    assert structure.method == "coarse poses, extended"
    assert structure.accepted
    assert structure.reconstruction.names == corner.photos.names


def test_a_wrong_coarse_reconstruction_is_not_believed(corner, solved, tmp_path):
    prior, matches, _, _ = solved
    own = prior.reconstruction
    rng = np.random.default_rng(1)
    shuffled = dataclasses.replace(own, translations=own.translations + rng.normal(0, 1.0, own.translations.shape))
    structure = map_fine(
        CONFIG,
        corner.photos,
        matches,
        dataclasses.replace(prior, reconstruction=shuffled),
        scratch=tmp_path,
        **ONE_THREAD,
    )
    # The last step needs no coarse poses: runs from nothing on disjoint halves of the tracks agree with each other.
    assert structure.method == "incremental, confirmed by both halves"
    assert structure.accepted
    assert np.median(position_errors(structure.reconstruction, corner)) < 0.5


def test_file_order_alone_is_enough(corner, solved, tmp_path):
    prior = sequence_prior(dataclasses.replace(solved[0], reconstruction=None))
    matches = match_all(CONFIG, corner.photos, prior, tmp_path / "match")
    structure = map_fine(CONFIG, corner.photos, matches, prior, scratch=tmp_path / "map", **ONE_THREAD)
    assert structure.accepted
    assert structure.compared_with == "half of the tracks alone"


def test_given_poses_are_kept_to_the_last_bit(corner, solved, tmp_path):
    names = corner.photos.names
    given = Reconstruction(
        cameras=(Camera.pinhole(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2),),
        names=names,
        camera_ids=np.zeros(len(names), np.int64),
        rotations=corner.rotations,
        translations=-np.einsum("nij,nj->ni", corner.rotations, corner.centers),
    )
    photos = dataclasses.replace(corner.photos, given=given)
    assert needs_matching(CONFIG, photos)
    prior = given_prior(photos)
    shutil.copytree(solved[3] / "match" / "features", tmp_path / "match" / "features")
    matches = match_all(CONFIG, photos, prior, tmp_path / "match")
    kept = map_given(CONFIG, photos, matches, prior, scratch=tmp_path / "keep", **ONE_THREAD)
    assert kept.reconstruction.rotations.tobytes() == given.rotations.tobytes()
    assert kept.reconstruction.translations.tobytes() == given.translations.tobytes()
    assert kept.reconstruction.cameras == given.cameras
    assert len(kept.reconstruction.points) > 200
    assert np.median(kept.reconstruction.errors) < 0.5

    with_points = dataclasses.replace(photos, given=kept.reconstruction)
    assert not needs_matching(CONFIG, with_points)
    untouched = keep_given(CONFIG, with_points)
    assert untouched.reconstruction is kept.reconstruction
    assert untouched.grouping.kept.photos == names

    refining = StructureConfig(poses="refine")
    refined = map_given(refining, photos, matches, prior, scratch=tmp_path / "refine", **ONE_THREAD)
    assert refined.accepted
    assert refined.agreement.largest_shift < 0.02
    assert refined.reconstruction.translations.tobytes() != given.translations.tobytes()


def test_blank_photos_are_told_to_share_nothing(corner, tmp_path):
    (tmp_path / "photos").mkdir()
    for photo in corner.photos.photos:
        cv2.imwrite(str(tmp_path / photo.pixels), np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
    blank = dataclasses.replace(corner.photos, folder=tmp_path)
    with pytest.raises(
        DataError, match="no three of the 8 photos could be matched, for they show too little texture"
    ) as caught:
        coarse_poses(CONFIG, blank, scratch=tmp_path / "coarse", **ONE_THREAD)
    assert "something in them" in caught.value.hint
    prior = sequence_prior(own_prior(CONFIG, blank, scratch=tmp_path / "coarse", **ONE_THREAD))
    with pytest.raises(DataError, match="too little texture"):
        match_all(CONFIG, blank, prior, tmp_path / "match")


def test_copies_of_one_photo_are_told_apart_from_a_scene(corner, tmp_path):
    (tmp_path / "photos").mkdir()
    for photo in corner.photos.photos[:4]:
        shutil.copyfile(corner.photos.folder / corner.photos.photos[0].pixels, tmp_path / photo.pixels)
    copies = dataclasses.replace(corner.photos, folder=tmp_path, photos=corner.photos.photos[:4])
    with pytest.raises(DataError, match="no three photos could be placed") as caught:
        coarse_poses(CONFIG, copies, scratch=tmp_path / "coarse", **ONE_THREAD)
    assert "different places" in caught.value.hint


def test_the_larger_of_two_scenes_goes_on_and_the_other_is_named(corner, tmp_path):
    other = corner_scene(tmp_path / "other", count=3, seed=7)
    (tmp_path / "photos").mkdir()
    photos = []
    for k, (folder, photo) in enumerate(
        [(corner.photos.folder, p) for p in corner.photos.photos[:5]]
        + [(other.photos.folder, p) for p in other.photos.photos]
    ):
        pixels = f"photos/{k:06d}.png"
        shutil.copyfile(folder / photo.pixels, tmp_path / pixels)
        photos.append(dataclasses.replace(photo, name=f"{k}.jpg", pixels=pixels))
    both = dataclasses.replace(corner.photos, folder=tmp_path, photos=tuple(photos))
    config = StructureConfig(coarse_retry_max_side=400, coarse_retry_features=500)
    prior = coarse_poses(config, both, scratch=tmp_path / "coarse", **ONE_THREAD)
    assert prior.placed.tolist() == [True] * 5 + [False] * 3
    matches = match_all(config, both, prior, tmp_path / "match")
    structure = map_fine(config, both, matches, prior, scratch=tmp_path / "map", **ONE_THREAD)
    assert structure.reconstruction.names == ("0.jpg", "1.jpg", "2.jpg", "3.jpg", "4.jpg")
    assert structure.accepted  # these poses are right
    assert structure.status == "partial"  # and not what was asked for
    assert structure.grouping.kept.photos == structure.reconstruction.names
    assert [name for name, _ in structure.unregistered] == ["5.jpg", "6.jpg", "7.jpg"]
    assert all("apart from the main group" in reason for _, reason in structure.unregistered)
