"""Initial points: the reconstruction's and dense ones, pruned by an octree where they crowd."""

from graphgs.points.config import PointsConfig
from graphgs.points.dense import dense_cloud
from graphgs.points.dense_cloud import DenseCloud
from graphgs.points.octree import keep_all, prune_octree
from graphgs.points.pruned import PrunedPoints
from graphgs.points.stage import initial_points

__all__ = [
    "DenseCloud",
    "PointsConfig",
    "PrunedPoints",
    "dense_cloud",
    "initial_points",
    "keep_all",
    "prune_octree",
]
