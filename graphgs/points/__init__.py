"""Initial points: the reconstruction's, pruned by an octree where they crowd."""

from graphgs.points.octree import keep_all, prune_octree
from graphgs.points.pruned import PrunedPoints
from graphgs.points.stage import PointsConfig, initial_points

__all__ = ["PointsConfig", "PrunedPoints", "initial_points", "keep_all", "prune_octree"]
