"""Settings of the stages that make the initial points."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class PointsConfig:
    """From which points Gaussians start, and how many of them."""

    dense: Literal["sweep", "none"] = "sweep"
    """Ours: add points on the surfaces that training photos agree on, found by plane sweep (decisions/0031)."""
    dense_max_side: int = 192
    """Long side of the photos that are swept, px."""
    dense_partners: int = 4
    """Other photos that each is compared with."""
    mode: Literal["octree", "none"] = "octree"
    """How more points than wanted become fewer; "none" keeps all reconstructed ones and draws dense ones at random."""
    fraction: float = 0.4
    """Of what the octree is given that it keeps; GraphGS keeps 100,000 of 245,820."""
    minimum: int = 100_000
    """No cloud is pruned below so many points, unless Gaussians need the room: few are a bad start."""
    fill_fraction: float = 0.6
    """Of `training.max_splats` that dense points fill up to: densification places the rest."""
    most_fraction: float = 0.9
    """Of `training.max_splats` that reconstructed points may take."""
    target: int | None = None
    """Points wanted; None = the four above decide."""
    tau: float | None = None
    """Merge octree nodes below this level of detail instead (see prune_octree)."""

    def __post_init__(self):
        if not 0.0 < self.fraction <= 1.0:
            raise ValueError(f"fraction: expected above 0 and at most 1, got {self.fraction}")
        if self.target is not None and self.tau is not None:
            raise ValueError("target, tau: expected one of them, got both")

    def target_for(self, count: int, *, max_splats: int) -> int:
        """Points to start from, where `count` are reconstructed."""
        if self.target is not None:
            return self.target
        room = max(self.fill_fraction * max_splats, min(count, self.most_fraction * max_splats))
        return max(1, min(max(self.minimum, round(self.fraction * count)), round(room)))
