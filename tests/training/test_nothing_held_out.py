"""No held-out photo enters a photometric term: not the loss, not consistency, not an exposure, not a pose."""

import cv2
import numpy as np
import pytest
import torch

from graphgs.rendering.splats import TENSORS
from graphgs.scene.views import Views
from graphgs.training import train
from graphgs.training.config import TrainConfig
from tests.support.tiny_scene import TinyScene, tiny_scene, tiny_surfaces

EVERYTHING = TrainConfig(
    steps=40,
    sampling="loss",
    consistency_source="both",
    consistency_target="random",
    consistency_from_fraction=0.0,
    consistency_interval=1,
    exposure="affine",
    refine_poses=True,
    poses_from_fraction=0.1,
    sky="sphere",
    robust_share=0.1,
    robust_from_fraction=0.2,
    lambda_depth=0.1,
)


def _train(scene: TinyScene, scratch):
    trained = train(
        EVERYTHING, scene.views, scene.graph, scene.points,
        surfaces=tiny_surfaces(scene), scratch=scratch, seed=3, threads=1,
    )  # fmt: skip
    arrays = [getattr(trained.splats, name).numpy() for name in TENSORS]
    return [*arrays, trained.viewmats, trained.exposures], trained


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reference")
    return _train(tiny_scene(folder), folder / "scratch")


@pytest.mark.parametrize("harm", ["noise", "gone"])
def test_held_out_photos_may_be_anything(tmp_path, reference, harm):
    scene = tiny_scene(tmp_path)
    for i in np.flatnonzero(scene.views.is_test):
        path = tmp_path / scene.views.images[i]
        if harm == "gone":
            path.unlink()
        else:
            photo = cv2.imread(str(path))
            cv2.imwrite(str(path), np.random.default_rng(i).integers(0, 256, photo.shape, dtype=np.uint8))
    arrays, _ = _train(scene, tmp_path / "scratch")
    for array, expected in zip(arrays, reference[0], strict=True):
        assert np.isfinite(array).all()
        assert np.array_equal(array, expected)


def test_a_training_photo_does_matter(tmp_path, reference):
    """Else the test above could not fail."""
    scene = tiny_scene(tmp_path)
    path = tmp_path / scene.views.images[1]
    cv2.imwrite(str(path), 255 - cv2.imread(str(path)))
    arrays, _ = _train(scene, tmp_path / "scratch")
    assert not any(np.array_equal(array, expected) for array, expected in zip(arrays, reference[0], strict=True))


def test_only_training_photos_are_read(tmp_path, monkeypatch):
    scene = tiny_scene(tmp_path)
    read, files = set(), Views.read
    monkeypatch.setattr(Views, "read", lambda views, i: (read.add(int(i)), files(views, i))[1])
    _train(scene, tmp_path / "scratch")
    assert read == set(np.flatnonzero(~scene.views.is_test).tolist())


def test_nothing_is_fitted_to_a_held_out_view(tmp_path, reference):
    _, trained = reference
    scene = tiny_scene(tmp_path)
    held_out = scene.views.is_test
    assert np.array_equal(trained.viewmats[held_out], scene.views.viewmats[held_out])
    assert np.array_equal(trained.exposures[held_out], np.tile(np.eye(3, 4, dtype=np.float32), (held_out.sum(), 1, 1)))
    assert not (trained.viewmats[~held_out] == scene.views.viewmats[~held_out]).all(axis=(1, 2)).any()
    assert torch.isfinite(trained.splats.means).all()
