"""Synthetic photo sets with exact ground truth."""

from graphgs.synth.street import Street, StreetConfig, write_street

__all__ = ["Street", "StreetConfig", "write_street"]
