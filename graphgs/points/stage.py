"""The points stage: from reconstructed and dense points to those that Gaussians start from."""

import numpy as np

from graphgs.errors import DataError
from graphgs.points.config import PointsConfig
from graphgs.points.dense_cloud import DenseCloud
from graphgs.points.octree import keep_all, prune_octree
from graphgs.points.pruned import PrunedPoints
from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction


def initial_points(
    config: PointsConfig,
    reconstruction: Reconstruction,
    dense: DenseCloud,
    *,
    max_splats: int,
    reporter: Reporter,
    threads: int,
) -> PrunedPoints:
    """The points to start training from. Raises DataError when the reconstruction has none.

    Dense points join until there are target / fraction, so that the octree keeps the share that GraphGS keeps; where
    so many are reconstructed, none join."""
    count = len(reconstruction.points)
    if count == 0:
        raise DataError(
            "points: the reconstruction has no 3D points to start from",
            hint="the photos share too little: add photos with more overlap, or check that they show one scene",
        )
    target = config.target_for(count, max_splats=max_splats)
    wanted = target if config.mode == "none" else round(target / config.fraction)
    positions, colors, errors, track_lengths = _joined(reconstruction, dense, max(0, wanted - count))
    if config.mode == "none":
        points = keep_all(positions, colors)
    else:
        points = prune_octree(
            positions,
            colors,
            errors=errors,
            track_lengths=track_lengths,
            target=None if config.tau is not None else target,
            tau=config.tau,
            threads=threads,
        )
    kept = len(points.positions)
    added = len(positions) - count
    reporter.progress(1, 1, f"{kept} of {count} points" + (f" and {added} dense ones" if added else ""))
    reporter.event("points", reconstructed=count, dense=added, kept=kept, coverage=points.coverage)
    return points


def _joined(
    reconstruction: Reconstruction, dense: DenseCloud, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(positions, colors, errors, track lengths) of all reconstructed and `count` of the dense points."""
    drawn = np.arange(len(dense))
    if count < len(dense):
        drawn = np.sort(np.random.default_rng(0).choice(len(dense), count, replace=False))
    return (
        np.concatenate([reconstruction.points, dense.positions[drawn]]),
        np.concatenate([reconstruction.colors, dense.colors[drawn]]),
        np.concatenate([np.maximum(reconstruction.errors, 0.0), 0.5 * dense.pixels[drawn]]),
        np.concatenate([reconstruction.track_lengths, dense.track_lengths[drawn]]),
    )  # COLMAP writes an error of -1 where it never measured one
