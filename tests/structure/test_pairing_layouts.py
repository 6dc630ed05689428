"""A thousand random layouts: whatever the cameras do, the pairs hold them together; and what large scenes cost."""

import dataclasses

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from graphgs.structure.pairing import make_pairs
from graphgs.structure.pairing_config import PairingConfig
from tests.support import camera_tracks as tracks

LAYOUTS = 1000


def _layout(rng: np.random.Generator) -> np.ndarray:
    """[N, 3] centres: a cloud, a line, a grid, far clusters, or all in a few places; shuffled, often with copies."""
    n = int(rng.integers(1, 40))
    kind = rng.integers(5)
    if kind == 0:
        centers = rng.normal(size=(n, 3))
    elif kind == 1:
        centers = np.arange(n)[:, None] * rng.normal(size=3) + rng.normal(0, rng.choice([0.0, 0.1]), (n, 3))
    elif kind == 2:
        centers = np.stack([np.arange(n) % 6, np.arange(n) // 6, np.zeros(n)], axis=1).astype(float)
    elif kind == 3:
        centers = rng.normal(size=(n, 3)) + 1e5 * rng.integers(0, 4, n)[:, None]
    else:
        centers = rng.normal(size=(3, 3))[rng.integers(0, 3, n)]
    copies = rng.random(n) < rng.choice([0.0, 0.3])
    centers[copies] = centers[rng.integers(0, n, copies.sum())]
    return centers[rng.permutation(n)] * 10.0 ** rng.integers(-6, 7)


def _is_connected(pairs: np.ndarray, n: int) -> bool:
    links = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return connected_components(links, directed=False)[0] == 1


@pytest.mark.filterwarnings("error")
def test_one_connected_graph_in_a_thousand_layouts():
    for seed in range(LAYOUTS):
        rng = np.random.default_rng(seed)
        centers = _layout(rng)
        n = len(centers)
        config = PairingConfig(
            r=int(rng.integers(1, 6)), h=int(rng.integers(0, 30)), exhaustive_limit=0,
            ring_limit=int(rng.integers(0, 40)), filter=str(rng.choice(["frustum", "octant"])),
        )  # fmt: skip
        names, rotations, ordered = [str(k) for k in range(n)], tracks.random_rotations(n, seed), bool(rng.integers(2))
        made = make_pairs(config, names, rotations, centers, fov_deg=60.0, ordered=ordered)
        assert _is_connected(made.pairs, n), f"layout {seed}"
        assert (made.pairs[:, 0] < made.pairs[:, 1]).all()
        assert (np.diff(made.pairs[:, 0] * n + made.pairs[:, 1]) > 0).all()
        all_of_them = make_pairs(dataclasses.replace(config, filter="none"), names, rotations, centers, ordered=ordered)
        had, has = (np.bincount(m.pairs.ravel(), minlength=n) for m in (all_of_them, made))
        assert (has >= np.minimum(had, config.least_per_camera)).all(), f"layout {seed}"


@pytest.mark.parametrize("order", ["driven", "shuffled", "many in one place"])
def test_large_scenes_have_few_pairs_per_camera(order):
    """Above 10,000 cameras at most 20 each, before anything is filtered; the nearest are all there."""
    n = 12_000
    _, centers = tracks.straight_track(n // 3, seed=0, jitter=0.1)
    if order == "shuffled":
        centers = centers[np.random.default_rng(0).permutation(n)]
    if order == "many in one place":
        centers[::4] = centers[0]
    rotations = np.tile(np.eye(3), (n, 1, 1))
    config = PairingConfig(filter="none")
    made = make_pairs(config, [str(k) for k in range(n)], rotations, centers, ordered=order != "shuffled")
    assert made.rings == "geometric"
    assert len(made.pairs) <= 20 * n
    assert _is_connected(made.pairs, n)
    assert np.bincount(made.pairs.ravel(), minlength=n).min() >= 5
