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
    given_axes: Literal["auto", "opencv", "opengl"] = "auto"
    """Camera axes of poses the input carries. auto: as the format has them, opengl (y up, z backward) for a
    transforms.json, else opencv (y down, z forward)."""
    given_inverse: bool = False
    """The input's poses were written the other way round: world-to-camera where the format has camera-to-world."""
    given_order: Literal["name", "number", "text"] = "name"
    """Photos that the input's poses belong to, one by one: sorted by name, by the numbers in the names (2 before 10),
    or by these as text without leading zeros (10 before 2)."""
    given_scale: float = 1.0
    """Factor on the input's intrinsics, where they belong to photos of another size."""
    given_points: Literal["keep", "drop"] = "keep"
    """Points that come with poses; drop: triangulated from the poses instead."""
    rigs: Literal["auto", "off"] = "auto"
    """auto: sibling folders with the same frames are cameras of a rig (left/, right/); off: folders mean nothing."""
