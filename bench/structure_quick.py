"""Structure estimation on a street of 75 photos: a quarter of an hour."""

from bench.structure import quick as run

__all__ = ["run"]
