"""Octree pruning: against its slow twin, and what it promises on clouds as reconstructions have them."""

import numpy as np
import pytest

from graphgs.points import PrunedPoints, keep_all, prune_octree
from graphgs.points.frame import BITS, Frame
from graphgs.points.octree import neighbor_distance
from tests.support.reference.octree import prune as slow_prune


def _cloud(count: int, seed: int = 0, *, outliers: int = 6, duplicates: int = 10):
    """Points on three walls, crowded in places, with far outliers and exact duplicates of position."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-1, 1, (count, 3)) * [8, 3, 20]
    positions[np.arange(count), rng.integers(0, 3, count)] = rng.choice([-4.0, 4.0], count)
    crowd = rng.uniform(size=count) < 0.5
    positions[crowd] = positions[crowd] * 0.05 + [3, 0, 5]
    positions[:outliers] *= 10.0 ** rng.uniform(2, 5, (outliers, 1))
    positions[outliers : outliers + duplicates] = positions[-1]
    colors = rng.integers(0, 256, (count, 3)).astype(np.uint8)
    return positions, colors, rng.exponential(0.8, count), rng.integers(2, 15, count)


def _prune(cloud, **options) -> PrunedPoints:
    positions, colors, errors, tracks = cloud
    return prune_octree(positions, colors, errors=errors, track_lengths=tracks, **options)


def _coarse_cells(positions, frame: Frame, level: int) -> set:
    return set(map(tuple, frame.quantize(positions) >> (BITS - level)))


@pytest.mark.parametrize(
    ("seed", "options"),
    [(0, {"target": 150}), (1, {"target": 37}), (2, {"tau": 0.05}), (3, {"target": 3}), (4, {})],
)
def test_equals_the_slow_twin(seed, options):
    cloud = _cloud(400, seed)
    fast, slow = _prune(cloud, **options), slow_prune(*cloud, **options)
    np.testing.assert_array_equal(fast.representative, slow.representative)
    np.testing.assert_array_equal(fast.colors, slow.colors)
    np.testing.assert_allclose(fast.positions, slow.positions, rtol=1e-10)
    np.testing.assert_allclose(fast.scales, slow.scales, rtol=1e-7)
    assert fast.coverage == pytest.approx(slow.coverage, rel=1e-7)


def test_order_of_points_does_not_matter():
    cloud = _cloud(3000)
    first = _prune(cloud, target=1000)
    shuffle = np.random.default_rng(9).permutation(3000)
    second = _prune([array[shuffle] for array in cloud], target=1000)
    for name in ("positions", "colors", "scales"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    np.testing.assert_array_equal(first.representative[shuffle], second.representative)
    assert first.coverage == second.coverage


@pytest.mark.parametrize("target", [1, 7, 500, 1999, 5000])
def test_target_is_met_and_no_coarse_cell_is_emptied(target):
    cloud = _cloud(5000)
    pruned = _prune(cloud, target=target)
    assert len(pruned.positions) == target
    frame = Frame.around(cloud[0])
    level = next(k for k in range(4, -1, -1) if k == 0 or len(_coarse_cells(cloud[0], frame, k)) <= target // 4)
    assert _coarse_cells(pruned.positions, frame, level) == _coarse_cells(cloud[0], frame, level)
    assert set(pruned.representative) == set(range(target))


def test_tau_goes_from_nothing_to_one_point_per_coarse_cell():
    cloud = _cloud(2000)
    frame = Frame.around(cloud[0])
    counts = [len(_prune(cloud, tau=tau).positions) for tau in (0.0, 0.01, 0.1, 100.0)]
    assert counts[0] == 2000
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] == len(_coarse_cells(cloud[0], frame, 4))


def test_coverage_and_representatives_are_what_they_say():
    cloud = _cloud(2000)
    pruned = _prune(cloud, target=600)
    moved = np.linalg.norm(cloud[0] - pruned.positions[pruned.representative], axis=1)
    assert pruned.coverage == moved.max()
    alone = np.bincount(pruned.representative)[pruned.representative] == 1
    np.testing.assert_array_equal(cloud[0][alone], pruned.positions[pruned.representative[alone]])
    np.testing.assert_array_equal(cloud[1][alone], pruned.colors[pruned.representative[alone]])


def test_outliers_neither_vanish_nor_coarsen_the_rest():
    positions, colors, errors, tracks = _cloud(3000, outliers=0)
    calm = _prune((positions, colors, errors, tracks), target=1500)
    far = positions.copy()
    far[:20] *= np.logspace(2, 9, 20)[:, None]
    wild = _prune((far, colors, errors, tracks), target=1500)
    near = np.arange(3000) >= 20
    moved = np.linalg.norm(far - wild.positions[wild.representative], axis=1)
    assert np.quantile(moved[near], 0.99) < 1.5 * calm.coverage
    # An outlier's stand-in is an outlier in the same direction. (Far enough out, distances no longer tell cells apart.)
    stand_in, outlier = wild.positions[wild.representative[:20]], far[:20]
    lengths = np.linalg.norm(stand_in, axis=1), np.linalg.norm(outlier, axis=1)
    assert lengths[0].min() > 0.5 * lengths[1].min() > 50
    assert ((stand_in * outlier).sum(1) > 0.99 * lengths[0] * lengths[1]).all()


def test_vague_points_merge_before_sure_ones():
    rng = np.random.default_rng(0)
    # Every point twice, a hair's breadth apart on either side: the same places, once sure and once vague.
    wall = np.column_stack([rng.uniform(-1, 0, 1500), rng.uniform(-1, 1, 1500), np.zeros(1500)])
    positions = np.concatenate([wall, wall * [-1, 1, 1]])
    errors = np.repeat([0.1, 3.0], 1500)
    pruned = prune_octree(
        positions, np.zeros((3000, 3), np.uint8), errors=errors, track_lengths=np.full(3000, 4), target=1500
    )
    kept_sure = len(np.unique(pruned.representative[:1500]))
    kept_vague = len(np.unique(pruned.representative[1500:]))
    assert kept_sure > 1.5 * kept_vague


def test_merged_point_is_the_weighted_mean():
    background = np.random.default_rng(0).uniform(-10, 10, (200, 3))
    pair = np.array([[0.0, 0.0, 0.0], [3e-3, 0.0, 0.0]]) + [1.01, 1.01, 1.01]
    positions = np.concatenate([background, pair])
    colors = np.full((202, 3), 0.2)
    colors[-1] = 0.8
    tracks = np.full(202, 2)
    tracks[-1] = 4
    pruned = prune_octree(positions, colors, track_lengths=tracks, target=201)
    merged = pruned.representative[-1]
    assert pruned.representative[-2] == merged
    np.testing.assert_allclose(pruned.positions[merged], pair[0] + [2e-3, 0, 0], atol=1e-6)
    np.testing.assert_allclose(pruned.colors[merged], 0.6, atol=1e-4)


def test_exact_duplicates_go_first_and_keep_their_place():
    positions, colors, errors, tracks = _cloud(1000, duplicates=0)
    positions[100:700] = positions[100]
    pruned = _prune((positions, colors, errors, tracks), target=401)
    assert len(np.unique(pruned.representative[100:700])) == 1
    np.testing.assert_array_equal(pruned.positions[pruned.representative[100]], positions[100])
    assert pruned.coverage == 0.0


@pytest.mark.parametrize("target", [None, 400, 1000])
def test_a_target_that_is_not_below_the_number_keeps_everything(target):
    cloud = _cloud(400)
    pruned = _prune(cloud, target=target)
    assert len(pruned.positions) == 400
    np.testing.assert_array_equal(pruned.positions[pruned.representative], cloud[0])


@pytest.mark.parametrize("count", [1, 2, 3, 50])
def test_identical_points_are_no_accident(count):
    positions = np.tile([1.0, 2.0, 3.0], (count, 1))
    pruned = prune_octree(positions, np.zeros((count, 3)), target=1)
    np.testing.assert_array_equal(pruned.positions, [[1.0, 2.0, 3.0]])
    assert (pruned.scales > 0).all()
    assert (prune_octree(positions, np.zeros((count, 3))).scales > 0).all()


def test_scales_follow_the_spacing_within_their_bounds():
    cloud = _cloud(4000)
    pruned = _prune(cloud, target=1500)
    near = neighbor_distance(pruned.positions)
    frame = Frame.around(cloud[0])
    ceiling = frame.cell_size(pruned.positions, 4)
    assert (pruned.scales > 0).all()
    assert (pruned.scales <= ceiling * (1 + 1e-12)).all()
    free = (near < ceiling) & (np.bincount(pruned.representative) == 1)
    assert free.sum() > 100
    np.testing.assert_array_equal(pruned.scales[free], near[free])
    assert (pruned.scales >= np.minimum(near, ceiling)).all()


def test_keep_all_leaves_points_and_order_alone():
    positions, colors, *_ = _cloud(300)
    kept = keep_all(positions, colors)
    np.testing.assert_array_equal(kept.positions, positions)
    np.testing.assert_array_equal(kept.representative, np.arange(300))
    assert kept.coverage == 0.0
    gaps = np.linalg.norm(positions[:, None] - positions[None], axis=-1) + np.diag(np.full(300, np.inf))
    expected = np.sort(gaps, axis=1)[:, :3].mean(1)
    np.testing.assert_allclose(kept.scales, np.maximum(expected, 1e-5 * Frame.around(positions).half), rtol=1e-9)


def test_save_and_load(tmp_path):
    pruned = _prune(_cloud(300), target=100)
    pruned.save(tmp_path)
    loaded = PrunedPoints.load(tmp_path)
    for name in ("positions", "colors", "scales", "representative"):
        np.testing.assert_array_equal(getattr(pruned, name), getattr(loaded, name))
        assert getattr(pruned, name).dtype == getattr(loaded, name).dtype
    assert loaded.coverage == pruned.coverage


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ({"positions": np.zeros((0, 3)), "colors": np.zeros((0, 3))}, {}, "at least one point"),
        ({"positions": np.zeros((4, 2))}, {}, r"positions: expected \[N, 3\], got \[4, 2\]"),
        ({"colors": np.zeros((3, 3))}, {}, r"colors: expected \[4, 3\], got \[3, 3\]"),
        ({"errors": np.zeros(5)}, {}, r"errors: expected \[4\], got \[5\]"),
        ({"errors": np.full(4, -1.0)}, {}, "0 or more"),
        ({"positions": np.array([[0, 0, 0], [np.nan, 0, 0], [0, 0, 0], [0, 0, 0]])}, {}, "positions: expected finite"),
        ({"track_lengths": np.array([1, 2, np.inf, 3])}, {}, "track_lengths: expected finite values, row 2"),
        ({}, {"target": 2, "tau": 0.1}, "got both"),
        ({}, {"target": 0}, "target: expected at least 1"),
        ({}, {"tau": np.nan}, "tau: expected 0 or more"),
    ],
)
def test_wrong_arguments_are_named(change, options, message):
    arrays = {"positions": np.zeros((4, 3)), "colors": np.zeros((4, 3)), "errors": None, "track_lengths": None}
    arrays |= change
    with pytest.raises(ValueError, match=message):
        prune_octree(
            arrays["positions"],
            arrays["colors"],
            errors=arrays["errors"],
            track_lengths=arrays["track_lengths"],
            **options,
        )
