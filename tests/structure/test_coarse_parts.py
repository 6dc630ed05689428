"""The parts below the coarse reconstruction: pairs, look-alikes, the focal vote, priors from elsewhere."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graphgs.errors import DataError, UsageError
from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.structure import coarse_attempt
from graphgs.structure.calibration.lens import PARAMETERS, opened
from graphgs.structure.calibration.starts import wide_open
from graphgs.structure.cameras import rescaled, shared_cameras
from graphgs.structure.candidates import candidate_pairs
from graphgs.structure.coarse_attempt import Attempt, _best_mapping, _Mapped, coarse_pairs
from graphgs.structure.config import StructureConfig
from graphgs.structure.focal import vote_focal
from graphgs.structure.gps import enu_from_wgs84
from graphgs.structure.pairing_config import PairingConfig
from graphgs.structure.prior import Prior
from graphgs.structure.priors import check_enough, exif_positions, gps_prior, make_prior, poses_prior, sequence_prior
from graphgs.structure.retrieval import similar_photos
from tests.support.corner_scene import photo


def photos_of(folder, count, **changes):
    return Photos(
        folder,
        tuple(dataclasses.replace(photo(f"{k:02d}.jpg", f"photos/{k:06d}.png"), **changes) for k in range(count)),
    )


def empty_prior(photos, similar=None):
    n = len(photos.photos)
    return Prior(
        names=photos.names,
        placed=np.zeros(n, dtype=bool),
        rotations=np.tile(np.eye(3), (n, 1, 1)),
        centers=np.full((n, 3), np.nan),
        cameras=shared_cameras(photos),
        refine=(),
        source="auto",
        similar=np.zeros((n, 0), np.int64) if similar is None else similar,
    )


def test_coarse_pairs_hold_window_powers_of_two_and_look_alikes():
    similar = np.full((20, 2), -1)
    similar[3] = [17, 4]
    pairs = {tuple(p) for p in coarse_pairs(similar, 20, window=3).tolist()}
    assert {(0, 1), (0, 2), (0, 3), (0, 4), (0, 8), (0, 16), (3, 17), (3, 4)} <= pairs
    assert not pairs & {(0, 5), (0, 6), (0, 7), (0, 9)}
    assert all(i < j for i, j in pairs)
    assert len(pairs) == 19 + 18 + 17 + 16 + 12 + 4 + 1


def test_photos_of_one_place_look_alike():
    rng = np.random.default_rng(0)
    places = rng.integers(0, 160, (3, 60, 128))
    order = [0, 1, 2, 0, 1, 2, 0, 1]
    described = [np.clip(places[p] + rng.normal(0, 6, (60, 128)), 0, 255).astype(np.uint8) for p in order]
    offsets = np.arange(len(order) + 1) * 60
    similar = similar_photos(np.concatenate(described), offsets, words=8, neighbors=10, seed=0)
    assert similar.shape == (8, 10)
    assert (similar[:, 7:] == -1).all()
    for k, place in enumerate(order):
        twins = [i for i, other in enumerate(order) if other == place and i != k]
        assert set(similar[k, : len(twins)].tolist()) == set(twins)


def test_photos_without_features_look_like_nothing():
    none = similar_photos(np.zeros((0, 128), np.uint8), np.zeros(4, np.int64), words=8, neighbors=2, seed=0)
    assert (none == -1).all()
    rng = np.random.default_rng(0)
    data = rng.integers(0, 255, (30, 128)).astype(np.uint8)
    some = similar_photos(data, np.array([0, 15, 15, 30]), words=64, neighbors=2, seed=0)
    assert some.tolist() == [[2, -1], [-1, -1], [0, -1]]


def fundamentals(K, motions):
    F = []
    for rotation, t in motions:
        cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
        F.append(np.linalg.inv(K).T @ cross @ rotation @ np.linalg.inv(K))
    return np.array(F)


@pytest.mark.parametrize("truth", [0.55, 1.0, 1.9])
def test_general_motion_votes_for_its_focal_length(truth):
    rng = np.random.default_rng(3)
    guess = np.array([[700.0, 0, 480], [0, 700.0, 320], [0, 0, 1]])
    K = guess.copy()
    K[[0, 1], [0, 1]] *= truth
    motions = [(Rotation.from_rotvec(rng.normal(0, 0.3, 3)).as_matrix(), rng.normal(0, 1, 3)) for _ in range(30)]
    F = fundamentals(K, motions)
    F[:6] = rng.normal(0, 1e-6, (6, 3, 3))  # a fifth of the pairs is wrong
    Ks = np.tile(guess, (30, 1, 1))
    vote = vote_focal(F, np.full(30, 100), Ks, Ks)
    assert vote.decided
    assert not vote.flat
    assert vote.scale == pytest.approx(truth, rel=0.02)


def test_straight_driving_leaves_the_focal_length_open():
    rng = np.random.default_rng(3)
    K = np.array([[700.0, 0, 480], [0, 700.0, 320], [0, 0, 1]])
    motions = [(np.eye(3), np.array([0.01, 0.0, 1.0]) + rng.normal(0, 0.01, 3)) for _ in range(30)]
    Ks = np.tile(K, (30, 1, 1))
    vote = vote_focal(fundamentals(K, motions), np.full(30, 100), Ks, Ks)
    assert vote.flat
    assert not vote.decided
    assert vote.scale == 1.0


def test_few_pairs_are_no_verdict():
    vote = vote_focal(np.zeros((0, 3, 3)), np.zeros(0, int), np.zeros((0, 3, 3)), np.zeros((0, 3, 3)))
    assert (vote.decided, vote.flat, vote.pairs) == (False, False, 0)


def test_photos_of_one_key_share_a_camera_and_its_focal_length(tmp_path):
    told = photos_of(tmp_path, 2, focal_px=300.0, camera_key="phone")
    guessed = photos_of(tmp_path, 9, camera_key="unknown")
    cameras = shared_cameras(Photos(tmp_path, told.photos + guessed.photos))
    assert cameras.camera_ids.tolist() == [0, 0] + [1] * 9
    assert cameras.known == (True, False)
    assert cameras.cameras[0].params == (300.0, 160.0, 120.0, 0.0)
    moved = rescaled(cameras, 1.25)
    assert moved.cameras[0] == cameras.cameras[0]  # a focal length from EXIF stays
    assert moved.cameras[1].params[0] == pytest.approx(1.25 * cameras.cameras[1].params[0])
    assert moved.known == (True, True)
    assert [opened(c, PARAMETERS).model for c in moved.cameras] == ["RADIAL", "RADIAL"]
    assert wide_open(moved) == ("focal", "k1")  # one of them took too few photos


def test_gps_becomes_metres_east_north_up():
    # One thousandth of a degree at 55.7 degrees north, from the radii of the WGS84 ellipsoid.
    positions = np.array([[55.7, 13.19, 40.0], [55.701, 13.19, 40.0], [55.7, 13.191, 40.0], [55.7, 13.19, 52.0]])
    enu = enu_from_wgs84(positions)
    np.testing.assert_allclose(enu[1] - enu[0], [0, 111.35, 0], atol=0.05)
    np.testing.assert_allclose(enu[2] - enu[0], [62.86, 0, 0], atol=0.05)
    np.testing.assert_allclose(enu[3] - enu[0], [0, 0, 12], atol=1e-3)
    across = enu_from_wgs84(np.array([[0.0, 179.9995, 0], [0.0, -179.9995, 0], [0.0, 179.9999, 0]]))
    assert np.linalg.norm(across[0] - across[1]) == pytest.approx(111.3, abs=0.1)


def test_gps_prior_names_what_is_missing(tmp_path):
    photos = photos_of(tmp_path, 4)
    with pytest.raises(DataError, match="only 0 of 4 photos have a GPS position in EXIF"):
        check_enough(exif_positions(photos), photos)
    some = [dataclasses.replace(p, gps=(50.0, 8.0 + 1e-4 * k, 0.0)) for k, p in enumerate(photos.photos[:3])]
    photos = Photos(tmp_path, (*some, photos.photos[3]))
    prior = gps_prior(empty_prior(photos), exif_positions(photos), note="EXIF GPS")
    assert prior.placed.tolist() == [True, True, True, False]
    assert not prior.oriented
    assert prior.origin == pytest.approx((50.0, 8.0001, 0.0))
    pairs = candidate_pairs(PairingConfig(), prior, reporter=Reporter(), threads=1)
    assert pairs.filter == "none"


def test_a_photo_without_pose_gets_its_look_alikes_and_its_neighbours(tmp_path):
    photos = photos_of(tmp_path, 30)
    similar = np.full((30, 2), -1)
    similar[10] = [25, 2]
    similar[28] = [10, 3]
    placed = np.arange(30) != 10
    centers = np.stack([np.arange(30.0), np.zeros(30), np.zeros(30)], axis=1)
    prior = dataclasses.replace(
        poses_prior(
            empty_prior(photos, similar),
            tuple(name for name, p in zip(photos.names, placed, strict=True) if p),
            np.tile(np.eye(3), (29, 1, 1)),
            centers[placed],
            note="test",
        )
    )
    pairs = candidate_pairs(PairingConfig(), prior, reporter=Reporter(), threads=1)
    named = {frozenset((pairs.names[i], pairs.names[j])) for i, j in pairs.pairs}
    lost = {other for pair in named if "10.jpg" in pair for other in pair if other != "10.jpg"}
    assert lost == {"25.jpg", "02.jpg", "28.jpg", "09.jpg", "11.jpg"}


def test_file_order_is_a_line(tmp_path):
    photos = photos_of(tmp_path, 40)
    prior = sequence_prior(empty_prior(photos))
    assert prior.placed.all()
    pairs = candidate_pairs(PairingConfig(), prior, reporter=Reporter(), threads=1)
    assert pairs.connect == "sequence"
    assert {(k, k + 1) for k in range(39)} <= {tuple(p) for p in pairs.pairs.tolist()}


@pytest.mark.parametrize("wanted", ["wishes", "learned=", "poses", "poses=", "gps=", "sequence=5", ""])
def test_an_unknown_prior_is_a_usage_error(tmp_path, wanted):
    with pytest.raises(UsageError, match="not known"):
        make_prior(
            StructureConfig(),
            photos_of(tmp_path, 3),
            wanted=wanted,
            scratch=tmp_path,
            reporter=Reporter(),
            threads=1,
            seed=0,
        )


def test_camera_models_keep_what_they_know():
    fisheye = Camera("OPENCV_FISHEYE", 100, 80, (50.0, 50.0, 50.0, 40.0, 0.1, 0.0, 0.0, 0.0))
    photos = photos_of(None, 9)
    cameras = dataclasses.replace(shared_cameras(photos), cameras=(fisheye,))
    assert opened(cameras.cameras[0], PARAMETERS) == fisheye


class MapperStandIn:
    """Answers mapping jobs with models of given size and error; the focal length tells which guess was asked."""

    def __init__(self, answers, focal_drift=1.0):
        self.answers, self.focal, self.drift = answers, None, focal_drift  # {focal: (placed, error_px)}

    def run(self, job, **arguments):
        if job == "set_cameras":
            self.focal = arguments["cameras"][0]["params"][0]
            return
        placed, error = self.answers[self.focal]
        Reconstruction(
            cameras=(Camera("SIMPLE_RADIAL", 320, 240, (self.focal * self.drift, 160.0, 120.0, 0.0)),),
            names=tuple(f"photos/{k:06d}.png" for k in range(placed)),
            camera_ids=np.zeros(placed, np.int64),
            rotations=np.tile(np.eye(3), (placed, 1, 1)),
            translations=np.zeros((placed, 3)),
            errors=np.full(5, error),
        ).save(arguments["out"])


@pytest.mark.parametrize(
    ("answers", "drift", "chosen"),
    [
        ({100.0: (50, 1.0), 200.0: (50, 0.8), 300.0: (50, 0.9)}, 1.0, 200.0),  # the least error
        ({100.0: (50, 1.0), 200.0: (20, 0.1), 300.0: (50, 0.9)}, 1.0, 300.0),  # but not of a part of the photos
        ({100.0: (49, 0.5), 200.0: (50, 0.8), 300.0: (50, 0.9)}, 1.0, 100.0),  # one photo fewer is about as many
        ({100.0: (50, 1.0), 200.0: (50, 0.8), 300.0: (50, 0.9)}, 3.0, None),  # a focal length that ran away
    ],
)
def test_of_several_guesses_the_mapping_with_the_least_error_wins(tmp_path, answers, drift, chosen):
    photos = photos_of(tmp_path, 50)
    start = shared_cameras(photos)
    guesses = [
        dataclasses.replace(start, cameras=(Camera("SIMPLE_RADIAL", 320, 240, (focal, 160.0, 120.0, 0.0)),))
        for focal in answers
    ]
    found = _best_mapping(
        photos, guesses, Attempt(640, 1000, 0, True), True, MapperStandIn(answers, drift), tmp_path, Reporter(), 1
    )
    assert (found.model.cameras[0].params[0] if found else None) == chosen
    assert found is None or found.cameras.cameras[0].params[0] == chosen


@pytest.mark.parametrize(
    ("strengths", "placed", "chosen", "mapped"),
    [
        ({0: 0.2}, {}, 0, []),
        ({0: 1.1, 100: 0.2}, {}, 100, [100]),  # a street of 600 photos, one seed of three
        ({0: 1.1, 100: 1.3, 200: 0.9}, {}, 200, [100, 200]),  # the scene repeats itself: the next steps decide
        ({0: 1.1, 100: 0.1, 200: 0.3}, {100: 20}, 200, [100, 200]),  # a part of the photos is no answer
    ],
)
def test_a_mapping_that_its_matches_contradict_is_tried_again(tmp_path, monkeypatch, strengths, placed, chosen, mapped):
    def model(seed):
        count = placed.get(seed, 50)
        return Reconstruction(
            cameras=(Camera("SIMPLE_RADIAL", 320, 240, (100.0 + seed, 160.0, 120.0, 0.0)),),
            names=tuple(f"{k}" for k in range(count)),
            camera_ids=np.zeros(count, np.int64),
            rotations=np.tile(np.eye(3), (count, 1, 1)),
            translations=np.zeros((count, 3)),
        )

    asked = []

    def best_mapping(photos, guesses, attempt, *rest):
        asked.append(attempt.seed)
        return _Mapped(model(attempt.seed), guesses[0], tmp_path)

    monkeypatch.setattr(coarse_attempt, "_best_mapping", best_mapping)
    monkeypatch.setattr(coarse_attempt, "read_verified", lambda database: None)
    monkeypatch.setattr(
        coarse_attempt, "_contradiction", lambda found, *rest: strengths[int(found.cameras[0].params[0]) - 100]
    )
    found = coarse_attempt._less_contradicted(
        None,
        _Mapped(model(0), "guess", tmp_path),
        ["guess"],
        Attempt(640, 1000, 0, False),
        False,
        None,
        tmp_path,
        Reporter(),
        1,
    )
    assert found.model.cameras[0].params[0] == 100 + chosen
    assert asked == mapped
