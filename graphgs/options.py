"""The settings people change most, as flags and as keyword arguments. Light: imported before anything heavy."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class Options:
    """The settings people change most; None leaves what the preset or the file says."""

    preset: Literal["preview", "standard", "best"] | None = None
    """How long to train and how large: preview is minutes on a laptop, standard (the default) an evening on a CPU,
    best is the field's full length."""
    device: str | None = None
    """Where training runs: auto, cpu, cuda:0."""
    max_side: int | None = None
    """[px] long side of the training images; structure has its own sizes."""
    steps: int | None = None
    """Executed training steps."""
    max_splats: int | None = None
    """Hard limit on the number of Gaussians."""
    seed: int | None = None
    """Of everything that draws."""
    threads: int | None = None
    """CPU threads; default: the CPUs this process may use."""
    prior: str | None = None
    """What chooses the pairs: auto, learned, sequence, gps, gps=FILE, poses=FILE. It never becomes the result, but GPS
    makes it metric, with z up and y north."""
    poses: Literal["keep", "refine", "prior"] | None = None
    """Poses the input carries: keep, refine or prior (choose pairs only)."""
    given_axes: Literal["auto", "opencv", "opengl"] | None = None
    """Camera axes of these poses: auto (as their format has them), opencv or opengl."""
    pairs: Literal["graphgs", "paper", "exhaustive", "sequential"] | None = None
    """Pair selection: graphgs, paper, exhaustive, sequential."""
    filter: Literal["frustum", "octant", "paper-strict", "paper-loose", "none"] | None = None
    """Pair filter: frustum, octant, paper-strict, paper-loose, none."""
    pairs_extra: Path | None = None
    """A file of pairs to match besides, one "a.jpg b.jpg" a line."""
    allow_partial: bool = False
    """Go on, with exit code 0, also when the result is PARTIAL: only part of the photos could be placed."""
    config: Path | None = None
    """A TOML file with settings, for example the run.toml of another run."""


# Option -> the setting it stands for.
SETTING_OF_OPTION = {
    "device": "run.device",
    "seed": "run.seed",
    "prior": "run.prior",
    "max_side": "structure.max_side",
    "poses": "structure.poses",
    "given_axes": "sources.given_axes",
    "steps": "training.steps",
    "max_splats": "training.max_splats",
    "pairs": "pairing.pairs",
    "filter": "pairing.filter",
    "pairs_extra": "pairing.extra_file",
}
