"""Learned matches in the coarse reconstruction: by a stand-in that matches SIFT features elsewhere, by XFeat itself
where it is installed, and by a user's model of relative poses."""

from itertools import accumulate

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graphgs.errors import DataError, UsageError
from graphgs.progress import Reporter
from graphgs.scene.similarity import align, diameter
from graphgs.structure import coarse, coarse_attempt, learned
from graphgs.structure.coarse import coarse_poses
from graphgs.structure.config import StructureConfig
from graphgs.structure.features import extract_features
from graphgs.structure.priors import make_prior, prior_fingerprint
from tests.support.corner_scene import corner_scene

ONE_THREAD = {"reporter": Reporter(), "threads": 1, "seed": 0}


@pytest.fixture(scope="module")
def corner(tmp_path_factory):
    return corner_scene(tmp_path_factory.mktemp("corner"), count=5)


def sift_elsewhere(photos, folder, *, max_side, max_features, threads, reporter):
    quiet = {"first_octave": 0, "threads": threads, "progress": lambda done, total: None}
    extract_features(photos, folder, max_side=max_side, max_features=max_features, **quiet)


def mutual_nearest(photos, features, pairs, folder, *, threads, reporter):
    """Matches in chunks of three pairs, in the files that `graphgs.learned` writes."""
    folder.mkdir(parents=True, exist_ok=True)
    described = [np.load(features / f"{p.pixels}.npz")["descriptors"].astype(np.float32) for p in photos.photos]
    matcher = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True)
    for first in range(0, len(pairs), 3):
        chunk = pairs[first : first + 3]
        found = [
            np.array([(m.queryIdx, m.trainIdx) for m in matcher.match(described[i], described[j])]) for i, j in chunk
        ]
        offsets = np.array(list(accumulate((len(f) for f in found), initial=0)))
        np.savez(folder / f"{first:08d}.npz", pairs=np.array(chunk), offsets=offsets, matches=np.concatenate(found))


def position_error(prior, corner) -> float:
    """Median, % of the scene."""
    moved = align(prior.centers, corner.centers).apply(prior.centers)
    return 100 * float(np.median(np.linalg.norm(moved - corner.centers, axis=1))) / diameter(corner.centers)


def test_matches_from_elsewhere_make_the_coarse_reconstruction(corner, tmp_path, monkeypatch):
    monkeypatch.setattr(coarse, "check_installed", lambda: None)
    monkeypatch.setattr(coarse_attempt, "learned_features", sift_elsewhere)
    monkeypatch.setattr(coarse_attempt, "learned_matches", mutual_nearest)
    prior = coarse_poses(StructureConfig(), corner.photos, scratch=tmp_path, **ONE_THREAD, learned=True)
    assert prior.placed.all()
    assert "by learned matches" in prior.note
    assert position_error(prior, corner) < 2  # a coarse reconstruction of photos 320 px wide


def test_learned_matches_come_last_and_only_where_they_are_installed(corner, tmp_path, monkeypatch):
    tried = []

    def nothing(config, photos, attempt, *rest):
        tried.append(attempt.learned)
        return coarse_attempt.Found(
            None, None, False, np.zeros((5, 0), int), np.full(5, 500), np.zeros((0, 2), int), ""
        )

    monkeypatch.setattr(coarse, "run_attempt", nothing)
    for installed, expected in ((True, [False, False, False, True]), (False, [False] * 3)):
        monkeypatch.setattr(coarse, "is_installed", lambda installed=installed: installed)
        tried.clear()
        with pytest.raises(DataError, match="no two of the 5 photos"):
            coarse_poses(StructureConfig(), corner.photos, scratch=tmp_path, **ONE_THREAD)
        assert tried == expected


def test_asked_for_without_its_package(corner, tmp_path, monkeypatch):
    monkeypatch.setattr(learned, "is_installed", lambda: False)
    with pytest.raises(UsageError, match="not installed") as caught:
        make_prior(StructureConfig(), corner.photos, wanted="learned", scratch=tmp_path, **ONE_THREAD)
    assert "graphgs[learned]" in caught.value.hint


def test_xfeat_places_the_photos(corner, tmp_path):
    if not learned.is_installed():
        pytest.skip("XFeat is not installed (pip install 'graphgs[learned]')")
    prior = make_prior(StructureConfig(), corner.photos, wanted="learned", scratch=tmp_path, **ONE_THREAD)
    assert prior.placed.all()
    assert "by learned matches" in prior.note
    assert position_error(prior, corner) < 4


MODEL = """
import numpy as np
from graphgs.structure.relative_poses import RelativePoses

def estimate(paths, pairs):
    assert len(paths) == 5 and all(path.is_file() for path in paths)
    truth = np.load({truth!r})
    rotations, centers = truth["rotations"], truth["centers"]
    i, j = pairs.T
    turn = rotations[j] @ rotations[i].transpose(0, 2, 1)
    shift = np.einsum("pij,pj->pi", rotations[j], centers[i] - centers[j])
    return RelativePoses(pairs, turn, shift, np.ones(len(pairs)))

def wrong(paths, pairs):
    return RelativePoses(pairs, np.zeros(3), np.zeros(3), np.ones(len(pairs)))
"""


def test_a_users_model_of_relative_poses_chooses_pairs(corner, tmp_path):
    np.savez(tmp_path / "truth.npz", rotations=corner.rotations, centers=corner.centers)
    file = tmp_path / "model.py"
    file.write_text(MODEL.format(truth=str(tmp_path / "truth.npz")))
    run = {"scratch": tmp_path / "coarse", **ONE_THREAD}
    prior = make_prior(StructureConfig(), corner.photos, wanted=f"learned={file}:estimate", **run)
    assert (prior.source, prior.oriented, prior.placed.tolist()) == ("learned", True, [True] * 5)
    assert prior.reconstruction is not None  # our own, for the final poses to start from
    fit = align(prior.centers, corner.centers)
    turned = prior.rotations @ fit.rotation.T @ corner.rotations.transpose(0, 2, 1)
    assert np.degrees(Rotation.from_matrix(turned).magnitude()).max() < 1
    assert position_error(prior, corner) < 2
    with pytest.raises(DataError, match="rotations: expected"):
        make_prior(StructureConfig(), corner.photos, wanted=f"learned={file}:wrong", **run)
    before = prior_fingerprint(f"learned={file}:estimate")
    file.write_text(file.read_text() + "\n")
    assert prior_fingerprint(f"learned={file}:estimate") != before
