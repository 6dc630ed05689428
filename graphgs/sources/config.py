"""Settings of the sources stage."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SourcesConfig:
    """How photos are decoded."""

    decode_max_side: int = 1600
    """[px] Long side of the decoded photos, which every later stage looks at (the pipeline raises it to the largest
    size a stage asks for). Default: structure at 1600 px is as accurate as at full size (SIFT at 1.5 s a photo)."""
