"""What the structure benchmark computes from what it measured."""

import dataclasses

import numpy as np
import pytest

from bench.pair_times import load_times, save_times
from bench.streets import Street
from bench.structure_matches import Timed
from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import Similarity

N = 12


@pytest.fixture
def truth():
    centers = np.stack([np.arange(N), np.arange(N) ** 2 / N, np.zeros(N)], 1).astype(float)
    return Reconstruction(
        cameras=(Camera.pinhole(10, 10, 8, 8, 5, 5),),
        names=tuple(f"{k:02d}" for k in range(N)),
        camera_ids=np.zeros(N, np.int64),
        rotations=np.tile(np.eye(3), (N, 1, 1)),
        translations=-centers,
    )


def test_the_error_is_free_of_the_world_and_counts_missing_photos(truth, tmp_path):
    scene = Street(tmp_path, None, None, truth, None, 0.0)
    moved = truth.transformed(Similarity(3.0, np.eye(3)[[1, 2, 0]], np.ones(3)))
    assert scene.error(moved) < 1e-9
    keep = N // 2 - 1  # fewer than half: the median photo is a missing one
    part = dataclasses.replace(
        moved,
        names=moved.names[:keep],
        camera_ids=moved.camera_ids[:keep],
        rotations=moved.rotations[:keep],
        translations=moved.translations[:keep],
    )
    assert scene.error(part) == pytest.approx(100)


def test_a_selector_costs_the_sum_over_its_pairs(tmp_path):
    timed = Timed(None, tmp_path, np.zeros(3), {(0, 1): 0.5, (0, 2): 0.25, (1, 2): 4.0}, {})
    assert timed.seconds(np.array([[0, 1], [0, 2]])) == 0.75


def test_times_of_pairs_are_kept_between_runs(tmp_path):
    seconds = {(0, 3): 0.5, (2, 5): 0.125}
    save_times(tmp_path / "times.npz", seconds)
    assert load_times(tmp_path / "times.npz") == seconds
    assert load_times(tmp_path / "others.npz") == {}
