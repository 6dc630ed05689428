"""The pairing stage: what is protected, what is counted, and that the artefact comes back whole."""

import subprocess
import sys

import numpy as np
import pytest

from graphgs.structure import concentric_pairs, filter_pairs
from graphgs.structure.pairing import Pairs, make_pairs
from graphgs.structure.pairing_config import PairingConfig
from tests.support import camera_tracks as tracks
from tests.support.reference.pairing import is_connected


def _names(n: int, start: int = 0) -> list[str]:
    return [f"{k:04d}.jpg" for k in range(start, start + n)]


def _made(rotations, centers, options=None, **kwargs) -> Pairs:
    kwargs = {"fov_deg": 60.0, "depth_range": (0.5, 20.0)} | kwargs
    return make_pairs(PairingConfig(**(options or {})), _names(len(centers)), rotations, centers, **kwargs)


def _as_set(pairs: np.ndarray) -> set:
    return {tuple(p) for p in pairs.tolist()}


def test_filter_sees_only_candidates_and_spares_the_protected():
    rotations, centers = tracks.straight_track(40, seed=0, jitter=0.05)
    made = _made(rotations, centers)
    candidates, kinds = concentric_pairs(centers, return_kinds=True)
    keep = filter_pairs(candidates, rotations, centers, fov_deg=60.0, depth_range=(0.5, 20.0))
    protected = kinds & (1 | 4) > 0
    assert (~keep & protected).any()  # sideways cameras of a rig: near, but looking away
    assert (~keep & ~protected).any()
    np.testing.assert_array_equal(made.pairs, candidates[keep | protected])
    np.testing.assert_array_equal(made.kinds, kinds[keep | protected])
    assert made.filtered == len(candidates) - len(made.pairs)
    assert made.exhaustive == 120 * 119 // 2
    assert (made.rings, made.filter, made.connect) == ("paper", "frustum", "sequence")


def test_paper_form_protects_only_the_connection():
    rotations, centers = tracks.straight_track(40, seed=0, jitter=0.05)
    made = _made(rotations, centers, {"pairs": "paper", "filter": "paper-strict"})
    candidates, kinds = concentric_pairs(centers, return_kinds=True)
    keep = filter_pairs(candidates, rotations, centers, mode="paper-strict") | (kinds & 4 > 0)
    np.testing.assert_array_equal(made.pairs, candidates[keep])


def test_every_camera_keeps_its_least():
    rotations, centers = tracks.random_box(80, 20.0)
    options = {"r": 0, "h": 4, "filter": "paper-strict"}
    few = _made(rotations, centers, options | {"least_per_camera": 0}, ordered=False)
    kept = _made(rotations, centers, options | {"least_per_camera": 4}, ordered=False)
    assert np.bincount(few.pairs.ravel(), minlength=80).min() < 4
    assert np.bincount(kept.pairs.ravel(), minlength=80).min() >= 4
    assert _as_set(few.pairs) < _as_set(kept.pairs)
    assert kept.connect == "mst"
    assert is_connected(kept.pairs, 80)


def test_small_scenes_are_exhaustive_and_larger_ones_are_not():
    rotations, centers = tracks.random_box(12)
    assert len(_made(rotations, centers).pairs) == 66
    rotations, centers = tracks.random_box(50)
    made = _made(rotations, centers, {"filter": "none"})
    assert made.filtered == 0
    assert len(made.pairs) <= 0.3 * made.exhaustive


@pytest.mark.parametrize("n", [0, 1, 2])
@pytest.mark.parametrize("pairs", ["graphgs", "paper", "exhaustive", "sequential"])
def test_next_to_no_cameras(n, pairs):
    made = _made(*[a[:n] for a in tracks.random_box(3)], {"pairs": pairs, "exhaustive_limit": 0})
    assert len(made.pairs) == made.exhaustive == n * (n - 1) // 2


def test_baselines():
    rotations, centers = tracks.random_box(40)
    assert len(_made(rotations, centers, {"pairs": "exhaustive"}).pairs) == 780
    sequential = _made(rotations, centers, {"pairs": "sequential", "r": 3})
    steps = np.unique(np.diff(sequential.pairs, axis=1))
    assert steps.tolist() == [1, 2, 3, 4, 8, 16, 32]
    assert set(sequential.kinds[np.diff(sequential.pairs, axis=1)[:, 0] == 1]) == {4}


def test_unplaced_photos_come_in_by_extra_pairs():
    rotations, centers = tracks.random_box(30)
    extra = np.array([[31, 2], [30, 31], [31, 2], [0, 1]])
    made = _made(rotations, centers, unplaced=_names(2, start=30), extra=extra)
    assert made.names == tuple(_names(32))
    assert made.exhaustive == 32 * 31 // 2
    kind = dict(zip(map(tuple, made.pairs.tolist()), made.kinds.tolist(), strict=True))
    assert kind[2, 31] == kind[30, 31] == 8
    assert kind[0, 1] & 4
    assert kind[0, 1] & 8
    assert (np.diff(made.pairs[:, 0] * 32 + made.pairs[:, 1]) > 0).all()
    with pytest.raises(ValueError, match="extra"):
        _made(rotations, centers, extra=np.array([[0, 30]]))


def test_large_scenes_get_rings_of_doubling_rank():
    rotations, centers = tracks.straight_track(40, seed=0, jitter=0.05)
    made = _made(rotations, centers, {"ring_limit": 100})
    assert made.rings == "geometric"
    assert is_connected(made.pairs, 120)


def test_artefact_comes_back_whole(tmp_path):
    made = _made(*tracks.random_box(40), unplaced=["ü/with space.png"], extra=np.array([[0, 40]]))
    made.save(tmp_path / "pairs")
    again = Pairs.load(tmp_path / "pairs")
    for field in ("names", "filtered", "exhaustive", "rings", "filter", "connect"):
        assert getattr(again, field) == getattr(made, field)
    np.testing.assert_array_equal(again.pairs, made.pairs)
    np.testing.assert_array_equal(again.kinds, made.kinds)
    assert again.kinds.dtype == np.uint8


def test_importing_the_room_loads_no_sfm_library():
    heavy = "{'pycolmap', 'torch', 'rustworkx'}"
    code = f"import sys, graphgs.structure, graphgs.graph; print(sorted({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"
