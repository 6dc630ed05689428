"""Settings of the sources stage."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class SourcesConfig:
    """How photos are decoded."""

    decode_max_side: int = 1600
    """[px] Long side of the decoded photos, which every later stage looks at (the pipeline raises it to the largest
    size a stage asks for). Default: structure at 1600 px is as accurate as at full size (SIFT at 1.5 s a photo)."""
    focal_px: float | None = None
    """[px] focal length of all photos, at the size of the files; None: EXIF's, or found from the photos. Straight
    driving does not determine one, and depth is stretched by as much as it is wrong."""
    rigs: Literal["auto", "off"] = "auto"
    """auto: sibling folders with the same frames are cameras of a rig (left/, right/); off: folders mean nothing."""
