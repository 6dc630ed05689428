"""The overlap gate: against its definition, on a street whose truth is known, and what it must not depend on."""

import itertools

import numpy as np
import pytest

from graphgs.structure import concentric_pairs, filter_pairs
from graphgs.structure.coarse_views import FEWEST_POINTS, depth_ranges, frustum_views, local_points, with_points
from graphgs.structure.overlap import share_views
from graphgs.structure.uncertainty import PoseUncertainty, measured, of_reconstruction
from tests.support import camera_tracks as tracks
from tests.support.reference import overlap as reference
from tests.support.reference.filters import overlap
from tests.support.street_views import street_views

FOV = (65.0, 39.4)
NOISE_SIGMA = PoseUncertainty(0.1, 0.3 / np.sqrt(3))  # per axis, of 0.3 rad about a random axis and 0.3 m along each


@pytest.fixture(scope="module")
def street():
    """150 photos of a rig of three."""
    return street_views(50, width=160, samples=300, threads=2)


@pytest.fixture(scope="module")
def coarse(street):
    return street.coarse_points()


def _all_pairs(n: int) -> np.ndarray:
    return np.stack(np.triu_indices(n, 1), axis=1)


def _unprotected(centers: np.ndarray) -> np.ndarray:
    pairs, kinds = concentric_pairs(centers, return_kinds=True)
    return pairs[kinds & (1 | 4) == 0]


def _measured(street, keep: np.ndarray, pairs: np.ndarray) -> tuple[float, float]:
    """(recall on pairs that share a tenth of the surface they see, share of those that share nothing dropped)."""
    share = street.shared(pairs).mean(1)
    assert (share >= 0.1).sum() > 200
    assert (share == 0).sum() > 200
    return float(keep[share >= 0.1].mean()), float((~keep[share == 0]).mean())


def test_street_with_a_clean_prior(street, coarse):
    pairs = _unprotected(street.centers)
    pose = (street.rotations, street.centers)
    keep = filter_pairs(pairs, *pose, fov_deg=street.fov_deg, points=coarse.points, visible=coarse.visible)
    recall, dropped = _measured(street, keep, pairs)
    assert recall >= 0.99
    assert dropped >= 0.95
    for mode in ("octant", "paper-loose", "paper-strict"):
        other = _measured(street, filter_pairs(pairs, *pose, mode=mode), pairs)
        assert recall >= other[0]
        assert dropped > other[1]


def test_street_with_a_noisy_prior(street, coarse):
    """0.3 rad and 0.3 m, three draws together."""
    gate, octant = [], []
    for seed in range(3):
        rotations, centers, points = street.with_noise(coarse, angle=0.3, offset=0.3, seed=seed)
        pairs = _unprotected(centers)
        keep = filter_pairs(
            pairs, rotations, centers, fov_deg=street.fov_deg,
            points=points.points, visible=points.visible, uncertainty=NOISE_SIGMA,
        )  # fmt: skip
        gate.append(_measured(street, keep, pairs))
        octant.append(_measured(street, filter_pairs(pairs, rotations, centers, mode="octant"), pairs))
    recall, dropped = np.mean(gate, axis=0)
    assert recall >= 0.96
    assert dropped >= 0.8
    assert dropped > np.mean(octant, axis=0)[1]


def test_the_noise_model_is_what_it_says(street, coarse):
    rotations, centers, points = street.with_noise(coarse, angle=0.3, offset=0.3, seed=0)
    sigma = measured(rotations, centers, street.rotations, street.centers)
    # Uniform angles and offsets have other medians than normal ones of the same variance; a third is near enough.
    np.testing.assert_allclose(sigma, NOISE_SIGMA, rtol=0.33)
    moved = np.linalg.norm(points.points - coarse.points, axis=1)
    assert 0.1 < np.median(moved) < 3.0
    np.testing.assert_array_equal(points.visible, coarse.visible)


def test_equals_its_definition(street, coarse):
    """Every sample of every pair looked at, by the reference's loops."""
    chosen = np.arange(0, 150, 6)
    rotations, centers = street.rotations[chosen], street.centers[chosen]
    row = np.full(150, -1)
    row[chosen] = np.arange(len(chosen))
    visible = np.stack([row[coarse.visible[:, 0]], coarse.visible[:, 1]], axis=1)
    visible = visible[visible[:, 0] >= 0]
    visible = visible[(visible[:, 0] > 1) | (visible[:, 1] % 64 == 0)]  # two cameras with too few points
    n, half_angle = len(chosen), np.tile(np.radians(FOV) / 2, (len(chosen), 1))
    camera, local = local_points(rotations, centers, coarse.points, visible)
    depths = depth_ranges(camera, local[:, 2], n)
    views = with_points(frustum_views(half_angle, depths), rotations, centers, coarse.points, visible)
    assert views.has_points(np.arange(n)).tolist() == [np.sum(camera == k) >= FEWEST_POINTS for k in range(n)]
    assert not views.has_points(np.arange(2)).all()

    slope, far, samples = np.tan(half_angle[0]), [], []
    for k in range(n):
        if views.row[k] >= 0:
            own = local[(camera == k) & (local[:, 2] > 0)]
            middle, limits = reference.coarse_depths(own, slope)
            row, column = np.divmod(np.arange(32), 8)
            uv = np.stack([(column + 0.5) / 4 - 1, (row + 0.5) / 2 - 1], axis=1)
            grid = np.column_stack([uv * slope * middle.reshape(-1, 1), middle.ravel()])
            np.testing.assert_allclose(views.seen[views.row[k], :32], grid)
            np.testing.assert_allclose(views.far[views.row[k]], limits.ravel())
            assert {tuple(p) for p in views.seen[views.row[k], 32:]} <= {tuple(p) for p in own}
            far.append(limits)
        else:
            far.append(np.full((4, 8), depths[k, 1]))
        samples.append(views.samples(np.array([k]), slice(None))[0].T @ rotations[k] + centers[k])

    pairs = _all_pairs(n)
    for sigma in ((0.0, 0.0), (0.1, 0.0), (0.02, 0.5)):
        keep = share_views(pairs, rotations, centers, views, PoseUncertainty(*sigma))
        expected = []
        for i, j in pairs:
            counts = [
                reference.seen_count(samples[a], rotations[b], centers[b], half_angle[b], depths[b, 0], far[b], sigma)
                >= (6 if views.row[a] >= 0 else 3)
                for a, b in ((i, j), (j, i))
            ]
            expected.append(any(counts))
        assert 0.1 < np.mean(expected) < 0.9
        np.testing.assert_array_equal(keep, expected)


def test_what_lies_behind_a_wall_does_not_count():
    """One camera looks at a wall 5 m ahead; another one stands beyond the wall and looks on."""
    rng = np.random.default_rng(0)
    rotations, centers = np.stack([np.eye(3)] * 2), np.array([[0.0, 0, 0], [0.0, 0, 8]])
    wall = np.column_stack([rng.uniform(-2, 2, (200, 2)), np.full(200, 5.0)])
    beyond = np.column_stack([rng.uniform(-4, 4, (200, 2)), np.full(200, 20.0)])
    visible = np.stack([np.repeat([0, 1], 200), np.arange(400)], axis=1)
    pair = np.array([[0, 1]])
    options = {"points": np.concatenate([wall, beyond]), "visible": visible}
    assert not filter_pairs(pair, rotations, centers, fov_deg=60, **options)[0]
    assert filter_pairs(pair, rotations, centers, fov_deg=60, depth_range=(0.5, 20.0))[0]
    window = wall[:, 0] < 0
    options["points"][:200][window] *= 4.0  # the left half of the wall gives way to a view as far as 20 m
    assert filter_pairs(pair, rotations, centers, fov_deg=60, **options)[0]


def test_points_seen_by_both_are_proof():
    """Two cameras that, by their poses, look away from each other."""
    rng = np.random.default_rng(0)
    rotations = np.stack([np.eye(3), np.diag([-1.0, 1.0, -1.0])])
    centers = np.array([[0.0, 0, 0], [0.0, 0, -5]])
    points = rng.uniform(-1, 1, (40, 3)) + [0, 0, 10]
    for common, expected in ((2, False), (3, True)):
        visible = np.array([[0, p] for p in range(40)] + [[1, p] for p in range(common)])
        keep = filter_pairs(np.array([[0, 1]]), rotations, centers, fov_deg=60, points=points, visible=visible)
        assert keep[0] == expected
        doubled = np.concatenate([visible, visible])
        again = filter_pairs(np.array([[0, 1]]), rotations, centers, fov_deg=60, points=points, visible=doubled)
        assert again[0] == expected


def test_margins_grow_with_the_uncertainty(street, coarse):
    pairs, pose = _all_pairs(150)[::3], (street.rotations, street.centers)
    options = {"fov_deg": street.fov_deg, "points": coarse.points, "visible": coarse.visible}
    for sigmas in ([(s, 0.0) for s in (0, 0.05, 0.2, 0.6)], [(0.0, s) for s in (0, 0.2, 1.0, 5.0)]):
        kept = [filter_pairs(pairs, *pose, uncertainty=sigma, **options) for sigma in sigmas]
        for narrow, wide in itertools.pairwise(kept):
            assert (narrow <= wide).all()
            assert narrow.sum() < wide.sum()


@pytest.mark.parametrize("uncertainty", [None, (0.1, 0.2)])
def test_symmetric_and_unchanged_by_a_similarity(street, coarse, uncertainty):
    pairs, pose = _all_pairs(150)[::5], (street.rotations, street.centers)
    options = {"fov_deg": street.fov_deg, "visible": coarse.visible, "uncertainty": uncertainty}
    keep = filter_pairs(pairs, *pose, points=coarse.points, **options)
    assert 0.1 < keep.mean() < 0.95
    np.testing.assert_array_equal(filter_pairs(pairs[:, ::-1], *pose, points=coarse.points, **options), keep)
    np.testing.assert_array_equal(filter_pairs(pairs[::-1], *pose, points=coarse.points, **options)[::-1], keep)
    scaled = None if uncertainty is None else (0.1, 3.7 * 0.2)
    moved = tracks.moved(*pose)
    points = 3.7 * coarse.points @ tracks.random_rotations(1, 5)[0].T + np.random.default_rng(5).uniform(-50, 50, 3)
    again = filter_pairs(pairs, *moved, points=points, **options | {"uncertainty": scaled})
    # A sample on the very edge of an image may fall to the other side by rounding.
    assert (again != keep).sum() <= 1


@pytest.mark.parametrize(
    ("scene", "far"),
    [
        (tracks.random_box(60, 14.0), 20.0),
        (tracks.curve_track(24), 20.0),
        (tracks.loop_track(24), 20.0),
        (tracks.nadir_grid(8), 12.0),
    ],
    ids=["random box", "curve", "loop", "nadir grid"],
)
def test_frusta_alone_with_poses_that_are_sure(scene, far):
    """No points: what a narrow margin drops, against frusta sampled by the filters' own reference."""
    pairs = _all_pairs(len(scene[1]))
    share = np.array([overlap(i, j, *scene, far=far) for i, j in pairs])
    keep = filter_pairs(pairs, *scene, fov_deg=60.0, depth_range=(0.5, far), uncertainty=(np.radians(1.0), 0.01))
    assert keep[share >= 0.1].all()
    assert (~keep[share == 0]).mean() >= 0.95


def test_points_that_say_nothing_change_nothing():
    rotations, centers = tracks.random_box(40)
    pairs = _all_pairs(40)
    options = {"fov_deg": 60.0, "depth_range": (0.5, 20.0), "uncertainty": (0.05, 0.1)}
    plain = filter_pairs(pairs, rotations, centers, **options)
    few = {"points": np.ones((FEWEST_POINTS - 1, 3)), "visible": np.array([[3, p] for p in range(FEWEST_POINTS - 1)])}
    none = {"points": np.zeros((0, 3)), "visible": np.zeros((0, 2), int)}
    behind = centers[:1] - 10 * rotations[0, 2] + np.random.default_rng(0).normal(0, 0.1, (50, 3))
    wrong = {"points": behind, "visible": np.array([[0, p] for p in range(50)])}
    for said in (few, none, wrong):
        np.testing.assert_array_equal(filter_pairs(pairs, rotations, centers, **options, **said), plain)
    assert depth_ranges(np.array([0]), np.array([-1.0]), 3) is None


def test_bad_arguments_are_refused():
    rotations, centers = tracks.random_box(4)
    pair = np.array([[0, 1]])

    def keep(**options):
        return filter_pairs(pair, rotations, centers, fov_deg=60.0, **options)

    with pytest.raises(ValueError, match="points, visible: expected both"):
        keep(points=np.zeros((3, 3)))
    with pytest.raises(ValueError, match=r"points: expected \[K, 3\]"):
        keep(points=np.zeros((3, 2)), visible=np.array([[0, 0]]))
    with pytest.raises(ValueError, match="finite"):
        keep(points=np.full((3, 3), np.nan), visible=np.array([[0, 0]]))
    with pytest.raises(ValueError, match="cameras below 4 and points below 3"):
        keep(points=np.zeros((3, 3)), visible=np.array([[0, 3]]))
    with pytest.raises(ValueError, match=r"visible: expected \[V, 2\] int"):
        keep(points=np.zeros((3, 3)), visible=np.array([[0.0, 1.0]]))
    for bad in ((-1.0, 0.0), (0.0, np.inf)):
        with pytest.raises(ValueError, match="uncertainty"):
            keep(uncertainty=bad)


def test_a_clean_reconstruction_is_known_to_a_degree():
    centers = np.arange(50.0)[:, None] * [2.0, 0.0, 0.0]
    sigma = of_reconstruction(centers)
    assert sigma.rotation == pytest.approx(np.radians(1.0))
    assert sigma.position == pytest.approx(0.06)  # a percent of three steps of 2


def test_coarse_points_are_what_two_cameras_see(street, coarse):
    count = np.bincount(coarse.visible[:, 1], minlength=len(coarse.points))
    assert count.min() >= 2
    assert np.median(np.bincount(coarse.visible[:, 0], minlength=150)) > 100
