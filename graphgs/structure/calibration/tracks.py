"""The tracks a trial is made of and those it is tested on, and how well a point fits where the cameras are."""

from dataclasses import dataclass

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.calibration.projection import linearise, rays_of

_PER_PHOTO = 200  # observations: enough for a lens, and a trial costs a tenth of a whole adjustment
_SHORTEST = 3  # photos of a track; two rays meet nearly anywhere
_HELD_OUT = 10  # every tenth track is kept out of the adjustment, and all that thinning leaves
_MOST_HELD_OUT = 4000
_ROUNDS = 12  # of Levenberg and Marquardt's steps per point
_LOSS_PX = 1.0  # scale of Cauchy's loss, as in the adjustment: a wrong match must not outweigh a lens


@dataclass(frozen=True)
class Split:
    """Points of a model by index, disjoint."""

    adjusted: np.ndarray  # [A] int
    held_out: np.ndarray  # [B] int


def split_tracks(model: Reconstruction, *, seed: int) -> Split:
    """A thinned set of tracks that gives every photo observations enough; others of the same length are held out."""
    rng = np.random.default_rng(seed)
    wanted = np.full(len(model.names), _PER_PHOTO)
    offsets, images = model.track_offsets.tolist(), model.track_images
    chosen, rest = [], []
    for count, point in enumerate(rng.permutation(np.flatnonzero(model.track_lengths >= _SHORTEST)).tolist()):
        seen_by = images[offsets[point] : offsets[point + 1]]
        if count % _HELD_OUT and (wanted[seen_by] > 0).any():
            wanted[seen_by] -= 1
            chosen.append(point)
        elif len(rest) < _MOST_HELD_OUT:
            rest.append(point)
    return Split(np.sort(np.array(chosen, np.int64)), np.sort(np.array(rest, np.int64)))


def errors_of(
    model: Reconstruction,  # poses and lenses to test
    whole: Reconstruction,  # the same photos in the same order, with all tracks
    points: np.ndarray,  # [B] int into the points of `whole`
) -> np.ndarray:
    """[B] mean Cauchy loss of each track once its point lies where it fits these cameras best: about the squared error
    [px^2] where that is small. Infinite where no place in front of the cameras is found."""
    rows = np.concatenate([np.arange(whole.track_offsets[p], whole.track_offsets[p + 1]) for p in points])
    track = np.repeat(np.arange(len(points)), whole.track_lengths[points])
    images, seen = whole.track_images[rows].astype(np.int64), whole.track_xy[rows]
    best = None
    for start in (_met(model, images, seen, track, len(points)), whole.points[points]):
        found = _fitted(model, images, seen, track, start)
        best = found if best is None else np.minimum(best, found)
    return best


def _met(model: Reconstruction, images: np.ndarray, seen: np.ndarray, track: np.ndarray, count: int) -> np.ndarray:
    """[B, 3] the points closest to the rays of each track."""
    rays = np.empty((len(images), 3))
    camera_ids = model.camera_ids[images]
    for camera_id in np.unique(camera_ids):
        rows = np.flatnonzero(camera_ids == camera_id)
        rays[rows] = np.column_stack([rays_of(model.cameras[int(camera_id)], seen[rows]), np.ones(len(rows))])
    rays = np.einsum("mji,mj->mi", model.rotations[images], rays)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    normal = _sums(across, track, count) + 1e-9 * np.eye(3)
    return np.linalg.solve(normal, _sums(across @ model.centers[images][:, :, None], track, count))[:, :, 0]


def _fitted(
    model: Reconstruction, images: np.ndarray, seen: np.ndarray, track: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """[B] least cost of each track from its starting point."""
    place, count = start.copy(), len(start)
    damping = np.full(count, 1e-4)
    best, parts = _costs(model, images, place, seen, track)
    for _ in range(_ROUNDS):
        slope = parts.by_point.transpose(0, 2, 1)
        normal = _sums(slope @ parts.by_point, track, count)
        pull = _sums((slope @ parts.residuals[:, :, None])[:, :, 0], track, count)
        normal += (damping * np.trace(normal, axis1=1, axis2=2) + 1e-300)[:, None, None] * np.eye(3)
        tried = place - np.linalg.solve(normal, pull[:, :, None])[:, :, 0]
        cost, tried_parts = _costs(model, images, tried, seen, track)
        better = cost < best
        damping = np.where(better, damping / 5, damping * 10)
        place[better], best = tried[better], np.where(better, cost, best)
        taken = better[track]
        parts.residuals[taken], parts.by_point[taken] = tried_parts.residuals[taken], tried_parts.by_point[taken]
    return best


def _costs(model: Reconstruction, images: np.ndarray, place: np.ndarray, seen: np.ndarray, track: np.ndarray):
    parts = linearise(model, images, place[track], seen)
    loss = np.where(parts.ahead, _LOSS_PX**2 * np.log1p((parts.residuals**2).sum(1) / _LOSS_PX**2), np.inf)
    return np.bincount(track, loss, minlength=len(place)) / np.bincount(track, minlength=len(place)), parts


def _sums(values: np.ndarray, track: np.ndarray, count: int) -> np.ndarray:
    flat = values.reshape(len(values), -1)
    total = np.stack([np.bincount(track, column, minlength=count) for column in flat.T], axis=1)
    return total.reshape(count, *values.shape[1:])
