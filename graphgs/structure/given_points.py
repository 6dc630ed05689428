"""Do the points that came with poses lie where the photos see them?

With tracks, the photos say so themselves: each point is projected to where it was observed. Many exporters write
points alone; then the depths that matches of our own have by the poses are compared with the points in that direction.
"""

import numpy as np
from scipy.spatial import cKDTree

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.contradictions import project
from graphgs.structure.given_evidence import Errors, Sightings

BEHIND = 1.0  # of the longer side: told of a point that is as far off, or further, or behind the camera
_MOST = 50_000  # observations or points looked at
_BESIDE_RAD, _BESIDE = 0.02, 5  # the points compared with a feature: so near in direction, so many at most
_SAME_DEPTH = np.log(1.25)  # parallax of four times the error of features gives a depth to a quarter
_FEWEST = 50  # features with points beside them, to judge by
_SEEN_SHARE = 0.1  # of the points that a photo must see on average, for every point came from some photo


def track_errors(
    model: Reconstruction,
    sides_px: np.ndarray,  # [N] longer side of each photo, as its file has it
) -> Errors | None:
    """How far the points are from where they were observed; None without observations."""
    chosen = _some(len(model.track_images))
    if not len(chosen):
        return None
    point = np.repeat(np.arange(len(model.points)), model.track_lengths)[chosen]
    images = model.track_images[chosen]
    seen = project(model, images, model.points[point])
    side = np.array([max(camera.width, camera.height) for camera in model.cameras])[model.camera_ids]
    error = np.linalg.norm(seen - model.track_xy[chosen], axis=1) / side[images]
    return Errors(np.fmin(error, BEHIND), np.asarray(sides_px, float)[images])


def photos_astray(
    model: Reconstruction,
    errors: Errors,  # its `track_errors`
    limit: float,
) -> float:
    """Share of the photos of which most observations are further off."""
    images = model.track_images[_some(len(model.track_images))]
    seen = np.bincount(images, minlength=len(model.names))
    off = np.bincount(images[errors.error > limit], minlength=len(model.names))
    return float((2 * off > seen)[seen > 0].mean())


def share_misplaced(
    model: Reconstruction,
    sightings: Sightings,  # features of its photos
    posed: int,  # photos that the points came from, of which `model` may have only some
) -> float | None:
    """Share of the features that have points beside them in the image, and all of these at another depth. 1 where the
    photos see hardly any point at all; None where there is too little to compare."""
    points = model.points[_some(len(model.points))]
    agree, compared, in_view = [], 0, []
    for image in range(len(model.names)):
        local = points @ model.rotations[image].T + model.translations[image]
        distance = np.linalg.norm(local, axis=1)
        ahead = (local[:, 2] > 0) & (distance > 0)
        camera = model.camera_of(image)
        fx, fy, cx, cy = camera.focal_and_center
        tangents = local[ahead, :2] / local[ahead, 2:]
        inside = (np.abs(tangents * (fx, fy) + (cx, cy) - 0.5 * np.array([camera.width, camera.height]))) <= (
            0.5 * np.array([camera.width, camera.height])
        )
        in_view.append(int(inside.all(1).sum()))
        own = sightings.image == image
        if not ahead.any() or not own.any():
            continue
        tree = cKDTree(local[ahead] / distance[ahead, None])
        apart, which = tree.query(sightings.ray[own], k=_BESIDE, distance_upper_bound=_BESIDE_RAD)
        beside = np.append(distance[ahead], np.nan)[which]  # [K, 5]; NaN where there are fewer
        has = np.isfinite(apart).any(1)
        ratio = np.abs(np.log(beside[has] / sightings.distance[own][has, None]))
        agree.append(np.nanmin(ratio, axis=1) <= _SAME_DEPTH)
        compared += int(has.sum())
    if in_view and np.mean(in_view) < _SEEN_SHARE * len(points) / posed:
        return 1.0
    return None if compared < _FEWEST else float(1.0 - np.concatenate(agree).mean())


def _some(count: int) -> np.ndarray:
    """[at most _MOST] int, evenly drawn."""
    return np.arange(count) if count <= _MOST else np.sort(np.random.default_rng(0).choice(count, _MOST, replace=False))
