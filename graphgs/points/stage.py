"""The points stage: from a reconstruction to the points that Gaussians start from."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from graphgs.errors import DataError
from graphgs.points.octree import keep_all, prune_octree
from graphgs.points.pruned import PrunedPoints
from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction


@dataclass(frozen=True)
class PointsConfig:
    """How many of the reconstructed points become Gaussians."""

    mode: Literal["octree", "none"] = "octree"  # "none" keeps every point as it is
    fraction: float = 0.4  # of the points to keep; GraphGS keeps 100,000 of 245,820
    minimum: int = 100_000  # points; no cloud is pruned below it: few points are a bad start (decisions/0014)
    target: int | None = None  # points wanted; None = fraction and minimum decide
    tau: float | None = None  # merge nodes below this level of detail instead (see prune_octree)

    def __post_init__(self):
        if not 0.0 < self.fraction <= 1.0:
            raise ValueError(f"fraction: expected above 0 and at most 1, got {self.fraction}")
        if self.target is not None and self.tau is not None:
            raise ValueError("target, tau: expected one of them, got both")

    def target_for(self, count: int) -> int:
        """Points to keep of `count`."""
        return self.target if self.target is not None else max(self.minimum, round(self.fraction * count))


def initial_points(
    config: PointsConfig,
    reconstruction: Reconstruction,
    *,
    reporter: Reporter,
    threads: int,
) -> PrunedPoints:
    """The points to start training from. Raises DataError when the reconstruction has none."""
    count = len(reconstruction.points)
    if count == 0:
        raise DataError(
            "points: the reconstruction has no 3D points to start from",
            hint="the photos share too little: add photos with more overlap, or check that they show one scene",
        )
    if config.mode == "none":
        points = keep_all(reconstruction.points, reconstruction.colors)
    else:
        points = prune_octree(
            reconstruction.points,
            reconstruction.colors,
            errors=np.maximum(reconstruction.errors, 0.0),  # COLMAP writes -1 where it never measured one
            track_lengths=reconstruction.track_lengths,
            target=None if config.tau is not None else config.target_for(count),
            tau=config.tau,
            threads=threads,
        )
    kept = len(points.positions)
    reporter.progress(1, 1, f"{kept} of {count} points")
    reporter.event("points", reconstructed=count, kept=kept, coverage=points.coverage)
    return points
