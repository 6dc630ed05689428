"""From photos to poses: pairs, matching, mapping. Importing this loads nothing, least of all an SfM library."""

import importlib

_HOME = {
    "concentric_pairs": "graphgs.structure.concentric",
    "concentric_ranks": "graphgs.structure.concentric",
    "filter_pairs": "graphgs.structure.filters",
}

__all__ = ["concentric_pairs", "concentric_ranks", "filter_pairs"]


def __getattr__(name: str):
    """The worker processes start several times a run and need none of this: a second each saved."""
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    raise AttributeError(f"module 'graphgs.structure' has no attribute {name!r}")
