"""From photos to poses: pairs, matching, mapping. Importing this loads no SfM library."""

from graphgs.structure.concentric import concentric_pairs, concentric_ranks
from graphgs.structure.filters import filter_pairs

__all__ = ["concentric_pairs", "concentric_ranks", "filter_pairs"]
