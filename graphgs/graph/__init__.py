"""The camera graph: which views support each other, which matter most, which comes next."""

from graphgs.graph.camera_graph import CameraGraph
from graphgs.graph.sampler import ViewSampler

__all__ = ["CameraGraph", "ViewSampler"]
