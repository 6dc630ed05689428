"""Settings of the pairing stage."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class PairingConfig:
    """Which photos are compared with which."""

    pairs: Literal["graphgs", "paper", "exhaustive", "sequential"] = "graphgs"
    """graphgs: concentric pairs, filtered, with the r nearest protected; paper: as printed; the rest are baselines."""
    filter: Literal["frustum", "octant", "paper-strict", "paper-loose", "none"] = "frustum"
    """What drops concentric pairs that cannot share a view; not used by exhaustive and sequential."""
    extra_file: str | None = None
    """A file of further pairs to match, one "a.jpg b.jpg" a line; never filtered."""
    rotation_sigma_deg: float | None = None
    """[deg] standard deviation of the prior's rotations per axis; none: by its kind, measured where it can be."""
    position_sigma: float | None = None
    """[units of the prior's world] standard deviation of its positions per axis; none: as above."""
    r: int = 5
    """[cameras] nearest ones always taken (GraphGS, section 3.1); the window of sequential."""
    h: int = 20
    """[ranks] skipped per ring (GraphGS, section 3.1)."""
    w: int = 1
    """[ranks] taken per ring (GraphGS, section 3.1)."""
    ring_limit: int = 2000
    """[cameras] up to here the printed rings, O(N^2) pairs; above, rings of doubling rank. Not used by paper."""
    exhaustive_limit: int = 12
    """[cameras] up to here graphgs takes every pair: 66 at most, cheaper than a missed one."""
    least_per_camera: int = 3
    """[pairs] every camera keeps at least this many if it had them (strict filtering leaves some with 1)."""
    seed: int = 0
    """Of the random parts behind the rings of doubling rank."""
