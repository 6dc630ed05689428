"""Sparse octree on Taichi SNodes."""

from graphgs.kernels.octree.tree import DEPTH, NodeSums, SparseOctree

__all__ = ["DEPTH", "NodeSums", "SparseOctree"]
