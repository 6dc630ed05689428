"""Reprojection of one view's pixels into another, and the comparison of their colours."""

from graphgs.kernels.reproject.consistency import DepthPair, compare_views, reproject_depth

__all__ = ["DepthPair", "compare_views", "reproject_depth"]
