"""The ways of choosing pairs that ours are compared with."""

import numpy as np

from graphgs.structure import selectors
from tests.support import camera_tracks as tracks


def _as_set(pairs: np.ndarray) -> set:
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert len({tuple(p) for p in pairs.tolist()}) == len(pairs)
    return {tuple(p) for p in pairs.tolist()}


def test_exhaustive_and_sequential():
    assert len(_as_set(selectors.exhaustive_pairs(30))) == 435
    steps = {j - i for i, j in _as_set(selectors.sequential_pairs(40, window=3))}
    assert steps == {1, 2, 3, 4, 8, 16, 32}
    assert len(selectors.sequential_pairs(1)) == 0


def test_spatial_takes_the_nearest():
    centers = np.random.default_rng(0).normal(size=(60, 3))
    distance = np.linalg.norm(centers[:, None] - centers[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    expected = {tuple(sorted((i, int(j)))) for i in range(60) for j in np.argsort(distance[i])[:4]}
    assert _as_set(selectors.spatial_pairs(centers, 4)) == expected


def test_boxes_of_frusta(monkeypatch):
    """By brute force over the corners; the answer depends on the world's axes, which is why it is a baseline."""
    rotations, centers = tracks.random_box(50, 30.0)
    half_angle, depths = np.tile([0.5, 0.3], (50, 1)), np.tile([0.5, 8.0], (50, 1))
    boxes = []
    for k in range(50):
        corners = np.array(
            [[u * np.tan(0.5) * z, v * np.tan(0.3) * z, z] for u in (-1, 1) for v in (-1, 1) for z in (0.5, 8.0)]
        )
        world = corners @ rotations[k] + centers[k]
        boxes.append((world.min(0), world.max(0)))
    expected = {
        (i, j)
        for i in range(50)
        for j in range(i + 1, 50)
        if (boxes[i][0] <= boxes[j][1]).all() and (boxes[j][0] <= boxes[i][1]).all()
    }
    options = {"half_angle": half_angle, "depth_range": depths}
    found = selectors.frustum_box_pairs(rotations, centers, **options)
    assert _as_set(found) == expected
    assert 50 < len(expected) < 1000
    monkeypatch.setattr(selectors, "_CHUNK", 70)
    np.testing.assert_array_equal(selectors.frustum_box_pairs(rotations, centers, **options), found)
    turned = selectors.frustum_box_pairs(*tracks.moved(rotations, centers, scale=1.0), **options)
    assert _as_set(turned) != expected
