"""Concentric pairs against the definition, their invariances, and that they always hold together."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graphgs.scene.neighbours import local_spacing, median_spacing, nearest
from graphgs.structure import concentric_pairs, concentric_ranks
from graphgs.structure.connection import spanning_tree
from graphgs.structure.rings import geometric_ring_pairs
from tests.support.camera_tracks import moved, random_box, random_rotations, straight_track
from tests.support.reference import pairing as reference


def _grid(side: int) -> np.ndarray:
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1).astype(float)


SCENES = {
    "random": np.random.default_rng(0).normal(size=(70, 3)),
    "line with ties": np.arange(60.0)[:, None] * [1.0, 0.0, 0.0],
    "grid with ties": _grid(8),
    "one place": np.ones((30, 3)),
    "two places": np.repeat([[0.0, 0, 0], [5.0, 0, 0]], 15, axis=0),
}


def test_ranks_of_the_literal_form():
    assert len(concentric_ranks(600)) == 33
    assert len(concentric_ranks(2000)) == 99
    assert concentric_ranks(30).tolist() == [1, 2, 3, 4, 5, 26]
    assert concentric_ranks(60, r=2, h=3, w=2)[:8].tolist() == [1, 2, 3, 7, 8, 12, 13, 17]
    assert len(concentric_ranks(0)) == len(concentric_ranks(1)) == 0


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize(("r", "h", "w"), [(5, 20, 1), (2, 3, 2), (0, 4, 1), (3, 5, 0)])
def test_equal_to_the_definition(scene, r, h, w):
    centers = SCENES[scene]
    for connect in ("sequence", None):
        expected = reference.concentric_pairs(centers, r, h, w, connect)
        pairs, kinds = concentric_pairs(centers, r, h, w, connect=connect, return_kinds=True)
        assert [tuple(p) for p in pairs.tolist()] == sorted(expected)
        assert kinds.dtype == np.uint8
        assert kinds.tolist() == [expected[p] for p in sorted(expected)]


def test_chunks_give_the_same_pairs(monkeypatch):
    centers = SCENES["random"]
    whole = concentric_pairs(centers)
    monkeypatch.setattr("graphgs.structure.concentric._CHUNK", 150)
    np.testing.assert_array_equal(concentric_pairs(centers), whole)


def test_counts_of_the_paper():
    """About 18 thousand pairs for 600 cameras: 16 to 17.3 on a track, 18.3 on an exactly even line, 18.8 at random."""
    rng = np.random.default_rng(0)
    line = np.arange(600.0)[:, None] * [1.0, 0.0, 0.0]
    assert 18_200 < len(concentric_pairs(line)) < 18_400
    assert 15_900 < len(concentric_pairs(line + rng.normal(0, 0.1, (600, 3)))) < 17_300
    assert 18_700 < len(concentric_pairs(rng.normal(size=(600, 3)))) < 18_900


@pytest.mark.parametrize("rings", ["paper", "geometric"])
@pytest.mark.parametrize("connect", ["sequence", "mst"])
def test_small_and_degenerate_scenes(rings, connect):
    for n in (0, 1):
        assert concentric_pairs(np.zeros((n, 3)), rings=rings, connect=connect).shape == (0, 2)
    assert concentric_pairs(np.eye(3)[:2], rings=rings, connect=connect).tolist() == [[0, 1]]
    pairs = concentric_pairs(np.zeros((40, 3)), rings=rings, connect=connect)
    assert reference.is_connected(pairs, 40)


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match=r"camera 1 has"):
        concentric_pairs(np.array([[0, 0, 0], [np.nan, 0, 0]]))
    with pytest.raises(ValueError, match=r"expected \[N, 3\], got \[4, 2\]"):
        concentric_pairs(np.zeros((4, 2)))
    with pytest.raises(ValueError, match="h \\+ w >= 1"):
        concentric_pairs(np.zeros((4, 3)), h=0, w=0)
    with pytest.raises(ValueError, match="rings"):
        concentric_pairs(np.zeros((4, 3)), rings="square")
    with pytest.raises(ValueError, match="connect"):
        concentric_pairs(np.zeros((4, 3)), connect="glue")


@given(
    n=st.integers(1, 60),
    seed=st.integers(0, 2**16),
    clusters=st.integers(1, 5),
    connect=st.sampled_from(["sequence", "mst"]),
    rings=st.sampled_from(["paper", "geometric"]),
)
@settings(max_examples=60, deadline=None)
def test_always_one_sorted_connected_set(n, seed, clusters, connect, rings):
    """Also when the cameras stand in far clusters smaller than r, where neighbours alone would never leave one."""
    rng = np.random.default_rng(seed)
    centers = rng.normal(size=(n, 3)) + 1e4 * rng.integers(0, clusters, n)[:, None]
    pairs, kinds = concentric_pairs(centers, r=2, h=50, w=1, rings=rings, connect=connect, return_kinds=True)
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert (np.diff(pairs[:, 0] * n + pairs[:, 1]) > 0).all()
    assert (kinds > 0).all()
    assert (kinds & 4 > 0).sum() == n - 1
    assert reference.is_connected(pairs, n)


def test_two_clusters_fall_apart_without_connection():
    centers = np.random.default_rng(0).normal(size=(20, 3)) + np.repeat([0.0, 100.0], 10)[:, None]
    assert not reference.is_connected(concentric_pairs(centers, connect=None), 20)
    assert reference.is_connected(concentric_pairs(centers, connect="sequence"), 20)
    assert reference.is_connected(concentric_pairs(centers, connect="mst"), 20)


@pytest.mark.parametrize("rings", ["paper", "geometric"])
def test_a_similarity_changes_nothing(rings):
    for rotations, centers in (random_box(150), straight_track(50, seed=1, jitter=0.1)):
        new_rotations, new_centers = moved(rotations, centers)
        for connect in ("sequence", "mst"):
            before = concentric_pairs(centers, rings=rings, connect=connect, rotations=rotations, return_kinds=True)
            after = concentric_pairs(
                new_centers, rings=rings, connect=connect, rotations=new_rotations, return_kinds=True
            )
            np.testing.assert_array_equal(before[0], after[0])
            np.testing.assert_array_equal(before[1], after[1])


def test_geometric_rings_stay_few_and_reach_far():
    n = 5000
    centers = np.arange(n)[:, None] * [1.0, 0.0, 0.0] + np.random.default_rng(0).normal(0, 0.2, (n, 3))
    pairs, kinds = concentric_pairs(centers, rings="geometric", return_kinds=True)
    assert 5 * n < len(pairs) < 12 * n  # log N per camera, where the literal form has N / 42 more
    assert np.bincount(pairs.ravel()).max() < 60  # no hubs
    expected = {(min(i, j), max(i, j)) for i, row in enumerate(nearest(centers, 5)[0].tolist()) for j in row}
    assert {tuple(p) for p in pairs[kinds & 1 > 0].tolist()} == expected
    reach = np.abs(np.diff(pairs[kinds & 2 > 0], axis=1))
    assert np.histogram(np.log2(reach), bins=range(1, 13))[0].min() > n / 20  # some of every doubling of the rank
    np.testing.assert_array_equal(pairs, concentric_pairs(centers, rings="geometric", threads=2))
    assert not np.array_equal(pairs, concentric_pairs(centers, rings="geometric", seed=1))


def test_ring_pairs_are_the_nearest_of_their_part():
    """One level by hand: with four cameras the only level deals them into two parts of two."""
    order = np.random.default_rng([3, 2]).permutation(4)
    found = geometric_ring_pairs(np.random.default_rng(0).normal(size=(4, 3)), seed=3)
    assert {tuple(sorted(p)) for p in found.tolist()} == {tuple(sorted(order[:2])), tuple(sorted(order[2:]))}


@pytest.mark.parametrize("scene", SCENES)
def test_nearest_by_tree_equals_nearest_by_sort(scene, monkeypatch):
    centers = np.concatenate([SCENES[scene], SCENES[scene][:5]])
    expected = nearest(centers, 5)
    monkeypatch.setattr("graphgs.scene.neighbours._DENSE_LIMIT", 0)
    found = nearest(centers, 5)
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_array_equal(found[1], expected[1])


def test_spacing_ignores_cameras_in_the_same_place():
    centers = np.repeat(np.arange(20.0)[:, None] * [2.0, 0.0, 0.0], 3, axis=0)  # a rig of three in one place
    spacing = local_spacing(centers)
    assert spacing[30] == 2.0  # five nearest of another place: 2 2 2 2 2
    assert spacing[0] == 2.0  # 2 2 2 4 4
    assert local_spacing(np.ones((4, 3))).tolist() == [1.0] * 4
    assert local_spacing(np.zeros((1, 3))).tolist() == [1.0]
    assert median_spacing(np.arange(50.0)[:, None] * [1.0, 0, 0]) == 3.0


def test_tree_is_minimal_and_prefers_overlapping_views():
    rng = np.random.default_rng(0)
    centers, rotations = rng.normal(size=(17, 3)), random_rotations(17, 1)
    directions, spacing = rotations[:, 2], median_spacing(centers)
    tree = spanning_tree(centers, rotations)
    cost = sum(reference.link_cost(centers, directions, spacing, i, j) for i, j in tree)
    assert len(tree) == 16
    assert cost == pytest.approx(reference.tree_cost(centers, directions, spacing))


def test_tree_joins_clusters_by_their_shortest_links():
    """Clusters of 40 in a row, so that nobody's 16 nearest lie in another one."""
    rng = np.random.default_rng(0)
    centers = rng.uniform(-1, 1, (200, 3)) + np.repeat(np.arange(5) * 100.0, 40)[:, None] * [1.0, 0.0, 0.0]
    tree = spanning_tree(centers)
    assert len(tree) == 199
    assert reference.is_connected(tree, 200)
    bridges = tree[tree[:, 0] // 40 != tree[:, 1] // 40]
    assert (bridges // 40).tolist() == [[0, 1], [1, 2], [2, 3], [3, 4]]
    for i, j in bridges:
        a, b = centers[i // 40 * 40 : i // 40 * 40 + 40], centers[j // 40 * 40 : j // 40 * 40 + 40]
        shortest = np.linalg.norm(a[:, None] - b[None], axis=-1).min()
        assert np.linalg.norm(centers[i] - centers[j]) == pytest.approx(shortest)
