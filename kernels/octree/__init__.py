"""Sparse octree on Taichi SNodes."""

from graphgs.kernels.octree.tree import DEPTH, NodeSums, SparseOctree, sparse_octree

__all__ = ["DEPTH", "NodeSums", "SparseOctree", "sparse_octree"]
