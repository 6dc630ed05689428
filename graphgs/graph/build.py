"""From a reconstruction and its verified pairs to the camera graph."""

import numpy as np

from graphgs.graph.camera_graph import CameraGraph
from graphgs.scene.covisibility import shared_points
from graphgs.scene.reconstruction import Reconstruction


def build_camera_graph(
    reconstruction: Reconstruction,
    is_test: np.ndarray,  # [N] bool, in the order of reconstruction.names
    edges: np.ndarray,  # [E, 2] verified pairs, indices into reconstruction.names
    inliers: np.ndarray,  # [E] matches that passed geometric verification
    *,
    kinds: np.ndarray | None = None,  # [E] uint8 bits, why each pair was a candidate
) -> CameraGraph:
    """The verified graph: pairs that passed two-view verification AND share points of the final reconstruction.
    Repeated facades pass the first test, not the second."""
    edges = np.asarray(edges, np.int64).reshape(-1, 2)
    shared = shared_points(reconstruction)
    kept = np.asarray(shared[edges[:, 0], edges[:, 1]]).ravel() > 0 if len(edges) else np.zeros(0, bool)
    return CameraGraph(
        names=reconstruction.names,
        rotations=reconstruction.rotations,
        centers=reconstruction.centers,
        edges=edges[kept],
        inliers=np.asarray(inliers)[kept],
        is_test=np.asarray(is_test, bool),
        kinds=None if kinds is None else np.asarray(kinds)[kept],
    )
