"""Poses that training refined leave with the scene: in colmap/, in graph.json and in the training artefact."""

import numpy as np
import pytest

from graphgs import cli
from graphgs.graph import CameraGraph
from graphgs.scene.colmap import read_model
from graphgs.scene.views import Views
from graphgs.stages import TRAINING, VIEWS
from graphgs.synth.street import StreetConfig, write_street
from graphgs.training.trained import Trained


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A short run with all fits on, from the true poses."""
    folder = tmp_path_factory.mktemp("street")
    street = write_street(StreetConfig(frames=10, width=96, height=54, points=400, depth=False), folder / "photos")
    settings = ["refine_poses=true", "poses_from_fraction=0", "exposure=affine"]
    arguments = [item for setting in settings for item in ("--set", f"training.{setting}")]
    output = folder / "scene"
    command = ["run", str(street.truth), str(output), "--device", "cpu", "--threads", "1", "--steps", "20"]
    assert cli._guarded([*command, *arguments]) == 0
    return output


def test_refined_poses_are_exported(scene):
    trained, views = Trained.load(scene / "cache" / TRAINING.folder), Views.load(scene / "cache" / VIEWS.folder)
    training = ~views.is_test
    assert not (trained.viewmats[training] == views.viewmats[training]).all(axis=(1, 2)).any()
    assert np.array_equal(trained.viewmats[~training], views.viewmats[~training])
    graph = CameraGraph.load(scene / "graph.json")
    assert np.array_equal(graph.rotations, trained.viewmats[:, :3, :3])
    for folder in ("sparse/0", "original"):
        model = read_model(scene / "colmap" / folder)
        np.testing.assert_allclose(model.viewmats, trained.viewmats, atol=1e-9)  # quaternions in double precision
    assert trained.exposures.shape == (10, 3, 4)
