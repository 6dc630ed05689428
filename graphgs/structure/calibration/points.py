"""Points placed where they fit given cameras best, many at once."""

from dataclasses import dataclass

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.calibration.projection import Linearised, linearise, rays_of

_ROUNDS = 12  # of Levenberg and Marquardt's steps
_LOSS_PX = 1.0  # scale of Cauchy's loss, as in the adjustment: a wrong match must not outweigh the others


@dataclass(frozen=True)
class Observations:
    """Where photos saw B points."""

    count: int  # B
    track: np.ndarray  # [M] int, 0..B-1
    images: np.ndarray  # [M] int into the model's names
    seen: np.ndarray  # [M, 2] px

    @staticmethod
    def of(model: Reconstruction, points: np.ndarray) -> "Observations":
        """All observations of some of a model's points."""
        lengths = model.track_lengths[points]
        first = np.repeat(model.track_offsets[points], lengths)
        rows = first + np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        track = np.repeat(np.arange(len(points)), lengths)
        return Observations(len(points), track, model.track_images[rows].astype(np.int64), model.track_xy[rows])


@dataclass(frozen=True)
class Fitted:
    """Points and how well they fit."""

    place: np.ndarray  # [B, 3] world
    loss: np.ndarray  # [B] px^2, mean Cauchy loss of their observations; inf where one lies behind its camera
    information: np.ndarray  # [B, 3, 3] inverse covariance for observations that are 1 px off


def fitted(model: Reconstruction, seen: Observations, start: np.ndarray | None = None) -> Fitted:
    """The points of least squared reprojection error, from [B, 3] a start, or from where their rays come closest."""
    place = _met(model, seen) if start is None else start.copy()
    damping = np.full(seen.count, 1e-4)
    best, parts = _losses(model, seen, place)
    for _ in range(_ROUNDS):
        normal, pull = _normal(parts, seen)
        damped = normal + (damping * np.trace(normal, axis1=1, axis2=2) + 1e-300)[:, None, None] * np.eye(3)
        tried = place - np.linalg.solve(damped, pull[:, :, None])[:, :, 0]
        loss, tried_parts = _losses(model, seen, tried)
        better = loss < best
        damping = np.where(better, damping / 5, damping * 10)
        place[better], best = tried[better], np.where(better, loss, best)
        taken = better[seen.track]
        parts.residuals[taken], parts.by_point[taken] = tried_parts.residuals[taken], tried_parts.by_point[taken]
    return Fitted(place, best, _normal(parts, seen)[0])


def sums(values: np.ndarray, track: np.ndarray, count: int) -> np.ndarray:
    """[count, ...] sums of values [M, ...] over the observations of each point."""
    flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
    total = [np.bincount(track, column, minlength=count) for column in flat.T]
    return np.stack(total, axis=1).reshape(count, *values.shape[1:])


def _met(model: Reconstruction, seen: Observations) -> np.ndarray:
    """[B, 3] the points closest to the rays of each track."""
    rays = np.empty((len(seen.images), 3))
    camera_ids = model.camera_ids[seen.images]
    for camera_id in np.unique(camera_ids):
        rows = np.flatnonzero(camera_ids == camera_id)
        rays[rows] = np.column_stack([rays_of(model.cameras[int(camera_id)], seen.seen[rows]), np.ones(len(rows))])
    rays = np.einsum("mji,mj->mi", model.rotations[seen.images], rays)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    normal = sums(across, seen.track, seen.count) + 1e-9 * np.eye(3)
    aims = sums(across @ model.centers[seen.images][:, :, None], seen.track, seen.count)
    return np.linalg.solve(normal, aims)[:, :, 0]


def _normal(parts: Linearised, seen: Observations) -> tuple[np.ndarray, np.ndarray]:
    slope = parts.by_point.transpose(0, 2, 1)
    pull = (slope @ parts.residuals[:, :, None])[:, :, 0]
    return sums(slope @ parts.by_point, seen.track, seen.count), sums(pull, seen.track, seen.count)


def _losses(model: Reconstruction, seen: Observations, place: np.ndarray) -> tuple[np.ndarray, Linearised]:
    parts = linearise(model, seen.images, place[seen.track], seen.seen)
    squared = (parts.residuals**2).sum(1)
    loss = np.where(parts.ahead, _LOSS_PX**2 * np.log1p(squared / _LOSS_PX**2), np.inf)
    observed = np.maximum(np.bincount(seen.track, minlength=seen.count), 1)
    return np.bincount(seen.track, loss, minlength=seen.count) / observed, parts
