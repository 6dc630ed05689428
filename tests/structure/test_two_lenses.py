"""Photos of two lenses that share a camera are told apart, and those of one are left alone."""

import numpy as np
import pytest

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.calibration.trials import Trials
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.two_lenses import photo_focals, two_lenses
from tests.support.lens_scenes import LENS, ZOOM, lens_scene, write_model

ZOOMED = (2, 5, 8, 11, 14, 17, 20, 23, 26)


def asked(folder, zoomed):
    model = write_model("bend", folder / "model", zoomed=zoomed)
    with ColmapWorker(folder) as worker:
        return two_lenses(Trials(worker, model, folder / "trials", 0, 1), Reconstruction.load(model), seed=0)


def test_photos_of_a_longer_lens_get_a_camera_of_their_own(tmp_path):
    found = asked(tmp_path, ZOOMED)
    few = min((set(found.apart), set(range(30)) - set(found.apart)), key=len)
    assert few == set(ZOOMED)
    assert max(found.ratio, 1 / found.ratio) == pytest.approx(ZOOM, rel=0.02)
    assert found.gain > 0.3


def test_photos_of_one_lens_stay_together(tmp_path):
    assert asked(tmp_path, ()) is None


def test_a_photo_asks_for_the_focal_length_it_was_taken_with():
    logs, deviations = photo_focals(lens_scene("bend", zoomed=(7,)))
    assert logs[7] == pytest.approx(np.log(ZOOM), abs=0.1)
    others = np.delete(logs, 7)
    assert np.abs(others).max() < 6 * np.nanmedian(deviations)
    scene = lens_scene("bend")
    assert scene.cameras[0] == LENS
