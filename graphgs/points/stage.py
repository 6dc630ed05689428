"""The points stage: from reconstructed and dense points to those that Gaussians start from."""

import dataclasses
from typing import NamedTuple

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

    Where there is room, all reconstructed points stay and dense ones join, of which the octree keeps `config.fraction`;
    where there is none, it prunes the reconstructed ones. With `config.tau` it prunes what it is given of both."""
    count = len(reconstruction.points)
    if count == 0:
        raise DataError(
            "points: the reconstruction has no 3D points to start from",
            hint="the photos share too little: add photos with more overlap, or check that they show one scene",
        )
    target = config.target_for(count, max_splats=max_splats)
    room = max(0, target - count)
    given = _drawn(dense, room if config.mode == "none" else round(room / config.fraction))
    reconstructed, found = _Cloud.of(reconstruction), _Cloud.of(given)
    if config.mode == "none":
        points = keep_all(*reconstructed.joined(found)[:2])
    elif config.tau is not None:
        points = _pruned(reconstructed.joined(found), tau=config.tau, threads=threads)
    elif room:
        points = _beside(reconstructed, found, room, threads=threads)
    else:
        points = _pruned(reconstructed, target=target, threads=threads)
    kept = len(points.positions)
    reporter.progress(1, 1, f"{kept} of {count} points" + (f" and {len(given)} dense ones" if len(given) else ""))
    reporter.event("points", reconstructed=count, dense=len(given), kept=kept, coverage=points.coverage)
    return points


class _Cloud(NamedTuple):
    """What the octree reads of points."""

    positions: np.ndarray  # [N, 3] world
    colors: np.ndarray  # [N, 3] uint8 RGB
    errors: np.ndarray  # [N] px
    track_lengths: np.ndarray  # [N]

    @staticmethod
    def of(source: Reconstruction | DenseCloud) -> "_Cloud":
        if isinstance(source, DenseCloud):
            return _Cloud(source.positions, source.colors, 0.5 * source.pixels, source.track_lengths)
        errors = np.maximum(source.errors, 0.0)  # COLMAP writes -1 where it never measured one
        return _Cloud(source.points, source.colors, errors, source.track_lengths)

    def joined(self, other: "_Cloud") -> "_Cloud":
        return _Cloud(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


def _drawn(dense: DenseCloud, count: int) -> DenseCloud:
    """At most so many points, drawn evenly."""
    if count >= len(dense):
        return dense
    return dense.rows(np.sort(np.random.default_rng(0).choice(len(dense), count, replace=False)))


def _pruned(cloud: _Cloud, *, threads: int, target: int | None = None, tau: float | None = None) -> PrunedPoints:
    positions, colors, errors, track_lengths = cloud
    return prune_octree(
        positions, colors, errors=errors, track_lengths=track_lengths, target=target, tau=tau, threads=threads
    )


def _beside(reconstructed: _Cloud, dense: _Cloud, count: int, *, threads: int) -> PrunedPoints:
    """All reconstructed points and `count` that stand for the dense ones; sizes by the neighbours among both."""
    every = len(reconstructed.positions)
    if not len(dense.positions):
        return _pruned(reconstructed, target=every, threads=threads)
    fewer = _pruned(dense, target=count, threads=threads)
    size = len(fewer.positions)
    stand_in = _Cloud(fewer.positions, fewer.colors, np.zeros(size), np.ones(size))
    # Nothing merges here, but a lone far point is kept from becoming a wall.
    both = _pruned(reconstructed.joined(stand_in), target=every + size, threads=threads)
    representative = both.representative[np.concatenate([np.arange(every), every + fewer.representative])]
    return dataclasses.replace(both, representative=representative, coverage=fewer.coverage)
