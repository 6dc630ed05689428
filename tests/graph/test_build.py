"""The verified graph: pairs that passed two-view verification and share points of the final model."""

import numpy as np
import pytest

from graphgs.graph.build import build_camera_graph
from graphgs.scene.camera import Camera
from graphgs.scene.covisibility import shared_points
from graphgs.scene.reconstruction import Reconstruction

TRACKS = [[0, 1], [0, 1, 2], [2, 3], [1, 1], [3]]  # images that see each point; one sees the fourth twice


@pytest.fixture
def model() -> Reconstruction:
    n = 5  # the last image sees nothing
    rng = np.random.default_rng(0)
    images = np.concatenate(TRACKS)
    return Reconstruction(
        names=tuple(f"{k}.png" for k in range(n)),
        cameras=(Camera.pinhole(40, 30, 40.0, 40.0, 20.0, 15.0),),
        camera_ids=np.zeros(n, np.int64),
        rotations=np.tile(np.eye(3), (n, 1, 1)),
        translations=rng.normal(size=(n, 3)),
        points=rng.normal(size=(len(TRACKS), 3)),
        colors=np.zeros((len(TRACKS), 3), np.uint8),
        errors=np.ones(len(TRACKS)),
        track_offsets=np.cumsum([0] + [len(track) for track in TRACKS]),
        track_images=images,
        track_xy=rng.uniform(0, 30, (len(images), 2)),
    )


def test_shared_points_are_counted_once(model):
    counted = np.zeros((5, 5), int)
    for i in range(5):
        for j in range(5):
            counted[i, j] = 0 if i == j else sum(i in track and j in track for track in TRACKS)
    np.testing.assert_array_equal(shared_points(model).toarray(), counted)


def test_edges_without_a_shared_point_are_dropped_with_their_facts(model):
    edges = np.array([[0, 1], [0, 2], [0, 3], [1, 3], [2, 3], [3, 4]])
    inliers, kinds = np.array([50, 40, 90, 30, 20, 80]), np.array([1, 2, 3, 4, 5, 6], np.uint8)
    is_test = np.array([True, False, False, False, False])
    graph = build_camera_graph(model, is_test, edges, inliers, kinds=kinds)
    np.testing.assert_array_equal(graph.edges, [[0, 1], [0, 2], [2, 3]])
    np.testing.assert_array_equal(graph.inliers, [50, 40, 20])
    np.testing.assert_array_equal(graph.kinds, [1, 2, 5])
    np.testing.assert_array_equal(graph.is_test, is_test)
    np.testing.assert_allclose(graph.centers, model.centers)
    assert graph.names == model.names


def test_no_edges_at_all(model):
    graph = build_camera_graph(model, np.zeros(5, bool), np.zeros((0, 2)), np.zeros(0, int))
    assert graph.edges.shape == (0, 2)
    assert graph.kinds is None
    assert (graph.targets() == -1).all()
