"""Edge weights, targets, importance and sampling probabilities against the formulas and networkx."""

import json

import networkx as nx
import numpy as np
import pytest

from graphgs.errors import DataError
from graphgs.graph import CameraGraph
from tests.support import camera_tracks as tracks
from tests.support.reference import graph as reference
from tests.support.reference.filters import overlap


def _rig_graph(frames: int = 16, jitter: float = 0.05, test_every: int = 8) -> CameraGraph:
    """Three cameras drive straight on; edges are the pairs that see the same space, as verification leaves them."""
    rotations, centers = tracks.straight_track(frames, seed=0, jitter=jitter)
    n = len(centers)
    pairs = [(i, j) for i in range(n) for j in range(i + 1, n)]
    share = np.array([overlap(i, j, rotations, centers) for i, j in pairs])
    seen = share > 0.02
    return CameraGraph(
        names=[f"{k:03d}.png" for k in range(n)],
        rotations=rotations,
        centers=centers,
        edges=np.array(pairs)[seen],
        inliers=(1000 * share[seen]).astype(int),
        is_test=np.arange(n) % test_every == 0,
    )


def _random_graph(n: int = 60, seed: int = 0, density: float = 0.1) -> CameraGraph:
    rng = np.random.default_rng(seed)
    rotations, centers = tracks.random_box(n, 20.0, seed)
    edges = np.stack(np.triu_indices(n, 1), axis=1)
    edges = edges[rng.random(len(edges)) < density]
    inliers = rng.integers(0, 40, len(edges)) * (rng.random(len(edges)) < 0.9)
    return CameraGraph(
        [f"{k}" for k in range(n)], rotations, centers, edges, inliers, np.arange(n) % 8 == 0,
        kinds=rng.integers(1, 8, len(edges)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def rig():
    return _rig_graph()


@pytest.mark.parametrize("mode", ["graphgs", "paper"])
def test_weights_and_targets_equal_the_formulas(mode, rig):
    for graph in (_random_graph(), rig):
        expected = [reference.weight(graph, e, mode) for e in range(len(graph.edges))]
        # acos in the twin loses digits near 0 degrees, where the floor holds anyway
        np.testing.assert_allclose(graph.edge_weights(mode), expected, rtol=1e-6)
        assert graph.targets(mode).tolist() == reference.targets(graph, mode)


def test_no_test_view_is_a_target_or_has_one(rig):
    for graph in (_random_graph(), rig):
        for mode in ("graphgs", "paper"):
            targets = graph.targets(mode)
            assert (targets[graph.is_test] == -1).all()
            assert not graph.is_test[targets[targets >= 0]].any()
            assert (targets >= 0).any()
        assert (graph.importance()[graph.is_test] == 0).all()
        assert (graph.sampling_probability()[graph.is_test] == 0).all()


def test_every_target_of_a_three_camera_rig_overlaps():
    """Edges are all pairs here, as if nothing had been verified: only the corrected weight finds overlapping views."""
    rotations, centers = tracks.straight_track(20, seed=0, jitter=0.05)
    n = len(centers)
    edges = np.stack(np.triu_indices(n, 1), axis=1)
    graph = CameraGraph([str(k) for k in range(n)], rotations, centers, edges, np.ones(len(edges)), np.zeros(n, bool))

    def judged(mode: str) -> tuple[float, float]:
        """(share of targets with no overlap at all, mean angle to the target in degrees)"""
        targets = graph.targets(mode)
        none = np.mean([overlap(i, j, rotations, centers) == 0 for i, j in enumerate(targets)])
        cosine = (rotations[:, 2] * rotations[targets, 2]).sum(1)
        return float(none), float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())

    ours, printed = judged("graphgs"), judged("paper")
    assert ours[0] == 0.0
    assert ours[1] < 5.0
    assert printed[0] > 0.4
    assert printed[1] > 45.0


def test_verified_rig_has_only_overlapping_targets(rig):
    targets = rig.targets()
    training = np.flatnonzero(~rig.is_test)
    assert (targets[training] >= 0).all()
    assert all(overlap(i, targets[i], rig.rotations, rig.centers) > 0 for i in training)


def test_a_similarity_changes_nothing(rig):
    for graph in (_random_graph(), rig, _rig_graph(jitter=0.0)):
        rotations, centers = tracks.moved(graph.rotations, graph.centers)
        other = CameraGraph(graph.names, rotations, centers, graph.edges, graph.inliers, graph.is_test)
        np.testing.assert_allclose(other.edge_weights(), graph.edge_weights(), rtol=1e-7)
        np.testing.assert_array_equal(other.targets(), graph.targets())  # also on an even track, where weights tie
        np.testing.assert_array_equal(other.top_targets(4), graph.top_targets(4))


def _triple(angle_deg: float, inliers=(5, 5, 5)) -> CameraGraph:
    yaw = np.radians([0.0, angle_deg, 1.0])
    rotations = tracks.look(tracks.heading(yaw))
    centers = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]])
    return CameraGraph("abc", rotations, centers, [[0, 1], [0, 2], [1, 2]], inliers, [False] * 3)


def test_printed_weight_stays_as_printed():
    assert _triple(120.0).edge_weights("paper")[0] < 0
    assert _triple(89.999).edge_weights("paper")[0] > 1e3
    rotations = np.stack([np.eye(3), np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]), np.eye(3)])
    edges = [[0, 1], [0, 2], [1, 2]]
    graph = CameraGraph("abc", rotations, np.eye(3), edges, [1, 1, 1], [False] * 3)
    assert np.isposinf(graph.edge_weights("paper")[0])
    assert graph.targets("paper").tolist() == [1, 0, 1]
    assert np.isfinite(graph.edge_weights()).all()
    assert graph.targets().tolist() == [2, 0, 0]


def test_weight_falls_with_angle_down_to_the_floor():
    weights = [_triple(angle).edge_weights()[0] for angle in (0.0, 3.0, 10.0, 90.0, 180.0)]
    assert weights[0] == pytest.approx(weights[1])
    assert np.all(np.diff(weights[1:]) < 0)


def test_no_verified_point_means_weight_zero_and_no_target():
    graph = _triple(10.0, inliers=(0, 5, 0))
    assert graph.edge_weights().tolist() == [0.0, graph.edge_weights()[1], 0.0]
    assert graph.edge_weights("paper")[0] == 0.0
    assert graph.targets().tolist() == [2, -1, 0]
    assert graph.top_targets(3).tolist() == [[2, -1, -1], [-1, -1, -1], [0, -1, -1]]


def test_top_targets_start_with_the_target(rig):
    top = rig.top_targets(3)
    np.testing.assert_array_equal(top[:, 0], rig.targets())
    weight = {tuple(sorted(e)): w for e, w in zip(rig.edges.tolist(), rig.edge_weights(), strict=True)}
    for i, row in enumerate(top.tolist()):
        values = [weight[tuple(sorted((i, j)))] for j in row if j >= 0]
        assert values == sorted(values, reverse=True)


@pytest.mark.parametrize("seed", range(4))
def test_importance_equals_networkx(seed, rig):
    for graph in (_random_graph(seed=seed), _random_graph(seed=seed, density=0.03), rig):  # the sparse one falls apart
        np.testing.assert_allclose(graph.importance(), reference.importance(graph), rtol=1e-12, atol=1e-15)


def test_degree_equals_networkx(rig):
    for graph in (_random_graph(seed=1), rig):
        np.testing.assert_allclose(graph.importance("degree"), reference.degree(graph), rtol=1e-12, atol=0)
    with pytest.raises(ValueError, match="measure"):
        rig.importance("fame")


def test_sampling_probability_in_both_forms():
    graph = _random_graph()
    share = graph.importance() / graph.importance().max()
    training = ~graph.is_test
    np.testing.assert_allclose(graph.sampling_probability()[training], 0.5 + 0.5 * share[training])
    printed = graph.sampling_probability(mode="paper")
    np.testing.assert_allclose(printed[training], np.maximum(0.5, share[training]))
    np.testing.assert_allclose(graph.sampling_probability(0.2)[training].min(), 0.2 + 0.8 * share[training].min())
    with pytest.raises(ValueError, match="minimum"):
        graph.sampling_probability(1.5)


def test_complete_graph_and_no_graph_give_probability_one():
    n = 9
    rotations, centers = tracks.random_box(n)
    for edges in (np.stack(np.triu_indices(n, 1), axis=1), np.zeros((0, 2), int)):
        graph = CameraGraph("abcdefghi", rotations, centers, edges, np.ones(len(edges), int), np.arange(n) % 8 == 0)
        for mode in ("graphgs", "paper"):
            assert graph.sampling_probability(mode=mode).tolist() == [0, 1, 1, 1, 1, 1, 1, 1, 0]
    assert graph.targets().tolist() == [-1] * n


def test_graph_without_cameras():
    graph = CameraGraph((), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 2), int), [], [])
    assert len(graph.targets()) == len(graph.importance()) == len(graph.sampling_probability()) == 0


def test_file_comes_back_bit_for_bit_and_networkx_reads_it(tmp_path):
    graph = _random_graph()
    graph.save(tmp_path / "scene")
    again = CameraGraph.load(tmp_path / "scene" / "graph.json")
    assert again.names == graph.names
    for field in ("rotations", "centers", "edges", "inliers", "is_test", "kinds"):
        a, b = getattr(again, field), getattr(graph, field)
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
    data = json.loads((tmp_path / "scene" / "graph.json").read_text())
    read = nx.node_link_graph(data, edges="edges")
    assert read.number_of_nodes() == len(graph.names)
    assert read.number_of_edges() == len(graph.edges)
    i, j = graph.edges[3].tolist()
    assert read.edges[i, j]["weight"] == graph.edge_weights()[3]
    assert set(read.edges[i, j]["why"]) <= {"neighbour", "ring", "connection"}
    assert read.nodes[5]["importance"] == graph.importance()[5]


def test_file_without_kinds_and_a_damaged_file(tmp_path, rig):
    rig.save(tmp_path / "graph.json")
    assert CameraGraph.load(tmp_path).kinds is None
    empty = CameraGraph((), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 2), int), [], [])
    empty.save(tmp_path / "empty.json")
    assert CameraGraph.load(tmp_path / "empty.json").names == ()
    text = (tmp_path / "graph.json").read_text()
    for damaged in (text[: len(text) // 2], "{}", '{"nodes": [{"id": 3}], "edges": []}', "[]"):
        (tmp_path / "graph.json").write_text(damaged)
        with pytest.raises(DataError, match="not a camera graph"):
            CameraGraph.load(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"edges": [[0, 3]], "inliers": [1]}, "edges"),
        ({"edges": [[1, 1]], "inliers": [1]}, "edges"),
        ({"edges": [[0, 1], [1, 0]], "inliers": [1, 1]}, "each pair once"),
        ({"inliers": [1, 2]}, "inliers"),
        ({"centers": np.zeros((2, 3))}, r"centers: expected \[3, 3\], got \[2, 3\]"),
        ({"centers": np.full((3, 3), np.nan)}, "finite"),
        ({"names": ("a", "a", "b")}, "each photo once"),
    ],
)
def test_wrong_arrays_are_refused(change, message):
    good = {
        "names": ("a", "b", "c"),
        "rotations": np.tile(np.eye(3), (3, 1, 1)),
        "centers": np.eye(3),
        "edges": [[0, 1]],
        "inliers": [4],
        "is_test": [True, False, False],
    }
    CameraGraph(**good)
    with pytest.raises(ValueError, match=message):
        CameraGraph(**(good | change))
