"""Rigs in the coarse pairs and in the final poses, on made-up frames and on a rendered corner."""

import dataclasses
import shutil

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import align, diameter
from graphgs.sources.photos import Photos
from graphgs.sources.rigs import Rig
from graphgs.structure.candidates import candidate_pairs
from graphgs.structure.coarse import coarse_poses
from graphgs.structure.coarse_attempt import coarse_pairs
from graphgs.structure.config import StructureConfig
from graphgs.structure.mapping import map_fine
from graphgs.structure.matching import match_pairs
from graphgs.structure.pairing_config import PairingConfig
from graphgs.structure.result import Structure
from graphgs.structure.rigs import RigPose, median_rotation, rig_pose, sequences
from tests.support.corner_scene import corner_scene

ONE_THREAD = {"reporter": Reporter(), "threads": 1, "seed": 0}


def two_cameras(frames: int, *, missing: tuple[int, ...] = ()) -> Rig:
    """left/ then right/, in order of name; `missing` are photos that were never taken."""
    photos = np.stack([np.arange(frames), frames + np.arange(frames)], axis=1)
    photos[np.isin(photos, missing)] = -1
    return Rig(("left", "right"), photos)


def test_each_camera_has_its_own_file_order():
    rig = two_cameras(10, missing=(13,))
    rows = [row.tolist() for row in sequences(23, (rig,))]
    assert rows == [[13, 20, 21, 22], list(range(10)), [k for k in range(10, 20) if k != 13]]
    assert [row.tolist() for row in sequences(3, ())] == [[0, 1, 2]]


def test_coarse_pairs_go_along_each_camera_and_across_each_frame():
    pairs = {tuple(p) for p in coarse_pairs(np.zeros((20, 0), int), 20, 2, (two_cameras(10, missing=(13,)),)).tolist()}
    assert {(k, k + 10) for k in range(10) if k != 3} <= pairs
    assert (12, 14) in pairs  # neighbours once 13 is gone
    along = {(a, b) for a, b in pairs if (a < 10) == (b < 10)}
    assert pairs - along == {(k, k + 10) for k in range(10) if k != 3}
    assert {b - a for a, b in along if b < 10} == {1, 2, 4, 8}


def driven(rig: Rig, mount: np.ndarray, place: np.ndarray, *, jitter: float = 0.0, seed: int = 0) -> Reconstruction:
    """A winding drive; camera 1 sits at `place` in the frame of camera 0, turned by `mount`."""
    rng = np.random.default_rng(seed)
    frames = len(rig.photos)
    first = Rotation.from_rotvec(rng.normal(0, 0.2, (frames, 3))).as_matrix()
    centers = np.cumsum(rng.normal([0, 0, 1.0], 0.1, (frames, 3)), axis=0)
    second = mount @ first
    places = centers + np.einsum("nji,nj->ni", first, place + jitter * rng.normal(size=(frames, 3)))
    rotations, everywhere = np.concatenate([first, second]), np.concatenate([centers, places])
    return Reconstruction(
        cameras=(Camera.pinhole(64, 48, 60, 60, 32, 24),),
        names=tuple(f"{folder}/{k:03d}" for folder in rig.folders for k in range(frames)),
        camera_ids=np.zeros(2 * frames, int),
        rotations=rotations,
        translations=-np.einsum("nij,nj->ni", rotations, everywhere),
    )


MOUNT, PLACE = Rotation.from_rotvec([0.02, 0.6, -0.1]).as_matrix(), np.array([0.5, 0.02, -0.1])


def test_the_cameras_places_survive_wrong_frames(tmp_path):
    rig = two_cameras(20)
    truth = driven(rig, MOUNT, PLACE, jitter=0.001)
    wrong = truth.rotations.copy(), truth.translations.copy()
    for k in (21, 25, 30, 33, 38):
        wrong[0][k] = Rotation.from_rotvec([1.0, 0, 0.3]).as_matrix() @ wrong[0][k]
        wrong[1][k] += 3.0
    pose = rig_pose(rig, truth.names, dataclasses.replace(truth, rotations=wrong[0], translations=wrong[1]))
    assert pose.rigid
    assert pose.frames.tolist() == [20, 20]
    # a quarter of wrong frames moves a median by a fraction of the jitter's deviation
    assert np.linalg.norm(-pose.rotations[1].T @ pose.translations[1] - PLACE) < 0.002
    assert np.degrees(Rotation.from_matrix(pose.rotations[1] @ MOUNT.T).magnitude()) < 0.05
    assert pose.baselines[1] == pytest.approx(np.linalg.norm(PLACE), abs=0.002)
    assert pose.scaled(2.0).baselines[1] == pytest.approx(2 * pose.baselines[1])
    pose.save(tmp_path / "rig.npz")
    back = RigPose.load(tmp_path / "rig.npz")
    assert (back.folders, back.rigid, back.record()) == (pose.folders, pose.rigid, pose.record())


def test_cameras_that_move_apart_are_no_rig():
    rig = two_cameras(20)
    assert not rig_pose(rig, *_named(driven(rig, MOUNT, PLACE, jitter=0.5))).rigid
    walks = driven(rig, MOUNT, PLACE)
    other = driven(rig, MOUNT, PLACE, seed=1)
    mixed = dataclasses.replace(
        walks,
        rotations=np.concatenate([walks.rotations[:20], other.rotations[20:]]),
        translations=np.concatenate([walks.translations[:20], other.translations[20:]]),
    )
    pose = rig_pose(rig, *_named(mixed))
    assert not pose.rigid
    assert "do not keep their places" in pose.describe("")


def test_photos_without_a_pose_are_passed_over():
    rig = two_cameras(20, missing=(7,))
    truth = driven(rig, MOUNT, PLACE)
    kept = [k for k in range(40) if k not in (7, 22, 31)]
    fewer = Reconstruction(
        truth.cameras,
        tuple(truth.names[k] for k in kept),
        truth.camera_ids[kept],
        truth.rotations[kept],
        truth.translations[kept],
    )
    pose = rig_pose(rig, truth.names, fewer)
    assert pose.frames.tolist() == [19, 17]
    np.testing.assert_allclose(pose.rotations[1], MOUNT, atol=1e-9)
    nowhere = rig_pose(rig, truth.names, dataclasses.replace(fewer, names=tuple("x" + n for n in fewer.names)))
    assert not nowhere.rigid


def _named(reconstruction):
    return reconstruction.names, reconstruction


def test_the_median_rotation_is_not_pulled_by_a_third_of_wrong_ones():
    rng = np.random.default_rng(0)
    right = Rotation.from_rotvec(rng.normal(0, 1e-3, (20, 3))) * Rotation.from_matrix(MOUNT)
    wrong = Rotation.random(9, random_state=1)
    found = median_rotation(np.concatenate([right.as_matrix(), wrong.as_matrix()]))
    assert Rotation.from_matrix(found @ MOUNT.T).magnitude() < 3e-3


@pytest.fixture(scope="module")
def stereo(tmp_path_factory):
    """(photos of a corner by two cameras with a baseline of 0.15 m, true centres by name)."""
    folder = tmp_path_factory.mktemp("stereo")
    left, right = corner_scene(folder / "left", count=6), corner_scene(folder / "right", count=6, shift=0.15)
    (folder / "photos").mkdir()
    photos, centers = [], []
    for camera, scene in (("left", left), ("right", right)):
        for k, photo in enumerate(scene.photos.photos):
            pixels = f"photos/{len(photos):06d}.png"
            shutil.copyfile(scene.photos.folder / photo.pixels, folder / pixels)
            photos.append(dataclasses.replace(photo, name=f"{camera}/{k:02d}.jpg", pixels=pixels, camera_key=camera))
            centers.append(scene.centers[k])
    return Photos(folder, tuple(photos), rigs=(two_cameras(6),)), np.array(centers)


def test_a_stereo_rig_from_photos_to_metres(stereo, tmp_path):
    photos, truth = stereo
    config = StructureConfig(rig_baseline_m=0.15)
    prior = coarse_poses(config, photos, scratch=tmp_path / "coarse", **ONE_THREAD)
    pairs = candidate_pairs(PairingConfig(), prior, reporter=Reporter(), threads=1)
    matches = match_pairs(config, photos, pairs, prior, scratch=tmp_path / "match", **ONE_THREAD)
    structure = map_fine(config, photos, matches, prior, scratch=tmp_path / "map", **ONE_THREAD)
    assert structure.accepted
    assert structure.method.endswith("rig constrained")
    model = structure.reconstruction
    assert model.names == photos.names
    (pose,) = structure.rigs
    assert pose.rigid
    assert pose.baselines[1] == pytest.approx(0.15)
    apart = np.linalg.norm(model.centers[6:] - model.centers[:6], axis=1)
    np.testing.assert_allclose(apart, 0.15, rtol=1e-6)  # one place on the rig for all frames
    # metric: the size of the scene follows from the baseline alone, to what 0.2 px of noise leave of 0.15 m at 5 m
    assert diameter(model.centers) == pytest.approx(diameter(truth), rel=0.05)
    moved = align(model.centers, truth).apply(model.centers)
    assert 100 * np.median(np.linalg.norm(moved - truth, axis=1)) / diameter(truth) < 0.5
    structure.save(tmp_path / "saved")
    loaded = Structure.load(tmp_path / "saved")
    assert loaded.world == structure.world
    assert loaded.rigs[0].record() == pose.record()

    free = StructureConfig(rig_refinement="free")
    shutil.copytree(tmp_path / "map/1_triangulated", tmp_path / "free/1_triangulated")
    unconstrained = map_fine(free, photos, matches, prior, scratch=tmp_path / "free", **ONE_THREAD)
    assert unconstrained.world is None
    assert (
        np.ptp(
            np.linalg.norm(unconstrained.reconstruction.centers[6:] - unconstrained.reconstruction.centers[:6], axis=1)
        )
        > 1e-6
    )
