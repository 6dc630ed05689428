"""Parameters of a lens are believed where the photos determine them and held, and said to be, where they do not."""

import dataclasses

import numpy as np
import pytest

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.calibration.belief import Calibration
from graphgs.structure.calibration.lens import LensStart
from graphgs.structure.calibration.opening import self_calibrate
from graphgs.structure.calibration.points import Observations, fitted
from graphgs.structure.calibration.tracks import errors_of, split_tracks
from graphgs.structure.calibration.trials import Trials
from graphgs.structure.colmap import ColmapWorker
from tests.support.lens_scenes import LENS, lens_scene, write_model


def start(focal, origin):
    return (LensStart(Camera("SIMPLE_RADIAL", 800, 600, (focal, 400.0, 300.0, 0.0)), focal, origin),)


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    """calibration of (kind, focal length to start from, its origin), each asked once."""
    answers = {}

    def ask(kind, focal, origin) -> Calibration:
        key = (kind, focal, origin)
        if key not in answers:
            folder = tmp_path_factory.mktemp(kind)
            model = write_model(kind, folder / "model")
            with ColmapWorker(folder) as worker:
                trials = Trials(worker, model, folder / "trials", 0, 1)
                answers[key], _ = self_calibrate(trials, Reconstruction.load(model), start(focal, origin), seed=0)
        return answers[key]

    return ask


@pytest.mark.parametrize("kind", ["bend", "hilly"])
def test_a_lens_that_the_photos_determine_is_found_from_a_wrong_start(asked, kind):
    found = asked(kind, 700.0, "typical")
    focal, cx, cy, k1, k2 = found.cameras[0].params
    true = LENS.params
    assert found.refine == ("focal", "principal_point", "k1", "k2")
    assert focal == pytest.approx(true[0], rel=0.01)
    assert (cx, cy) == pytest.approx(true[1:3], abs=3.0)
    corner2 = 0.69
    assert k1 * corner2 + k2 * corner2**2 == pytest.approx(true[3] * corner2 + true[4] * corner2**2, abs=0.005)
    assert not found.cautions()


def test_a_straight_drive_holds_a_typical_focal_length_and_says_what_that_means(asked):
    found = asked("straight", 700.0, "typical")
    assert found.refine == ()
    assert found.cameras[0].distortion.tolist() == [0.0, 0.0, 0.0, 0.0]
    held = next(entry for entry in found.held if entry.parameter == "focal")
    assert held.uncertainty > 0.05
    assert held.shape.stretch == pytest.approx(held.uncertainty, rel=0.3)
    (said,) = found.cautions()
    assert "do not determine their focal length" in said
    assert "stretched along one direction" in said
    assert "sources.focal_px" in said


def test_a_focal_length_that_the_user_gave_is_held_without_caution(asked):
    found = asked("straight", 600.0, "given")
    assert found.cameras[0].params[0] == pytest.approx(600.0, rel=0.005)
    assert not any("focal length" in caution for caution in found.cautions())


def test_flat_ground_holds_exifs_focal_length_and_still_finds_the_distortion(asked):
    found = asked("flat", 615.0, "EXIF")
    assert "focal" not in found.refine
    assert "k1" in found.refine
    assert found.cameras[0].params[0] == pytest.approx(615.0, rel=0.03)
    focal, corner2 = found.cameras[0].params[0], 250000.0 / found.cameras[0].params[0] ** 2
    k1, k2 = found.cameras[0].distortion[:2]
    bending = k1 * corner2 + k2 * corner2**2
    assert bending == pytest.approx(LENS.params[3] * 0.69 + LENS.params[4] * 0.69**2, abs=0.01), focal


def test_what_is_believed_survives_being_written(asked):
    found = asked("straight", 700.0, "typical")
    assert Calibration.from_record(found.record()) == found


def test_points_are_placed_where_they_were():
    scene = lens_scene("bend")
    found = fitted(scene, Observations.of(scene, np.arange(50)))
    deviation = np.sqrt(np.linalg.inv(found.information).diagonal(axis1=1, axis2=2).sum(1)) * 0.3
    away = np.linalg.norm(found.place - scene.points[:50], axis=1)
    assert (away < 5 * deviation).all()
    assert np.median(away / deviation) < 1.5


def test_tracks_fit_worse_through_a_wrong_lens():
    scene = lens_scene("bend")
    points = np.arange(200)
    wrong = dataclasses.replace(scene, cameras=(dataclasses.replace(LENS, params=(580.0, *LENS.params[1:])),))
    right = errors_of(scene, scene, points)
    assert np.median(right) == pytest.approx(2 * 0.3**2, rel=0.3)
    assert np.median(errors_of(wrong, scene, points)) > 2 * np.median(right)


def test_held_out_tracks_take_no_part_and_every_photo_keeps_enough():
    scene = lens_scene("bend")
    split = split_tracks(scene, seed=0)
    assert not set(split.adjusted) & set(split.held_out)
    assert (scene.track_lengths[np.concatenate([split.adjusted, split.held_out])] >= 3).all()
    assert len(split.held_out) >= 0.1 * len(split.adjusted)
    per_photo = np.bincount(Observations.of(scene, split.adjusted).images, minlength=len(scene.names))
    every = np.bincount(scene.track_images, minlength=len(scene.names))
    assert (per_photo >= np.minimum(150, 0.5 * every)).all()
