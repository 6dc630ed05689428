"""Export: the scene in the formats of the field."""

from graphgs.export.ply import read_ply, write_ply

__all__ = ["read_ply", "write_ply"]
