"""Which pairs can share a view, judged by coarse poses and points: one pure predicate in four forms."""

import functools
import logging
from typing import Literal

import numpy as np
from scipy import sparse

from graphgs.scene.neighbours import median_spacing
from graphgs.structure.coarse_views import depth_ranges, frustum_views, local_points, with_points
from graphgs.structure.overlap import share_views
from graphgs.structure.pair_set import check_centers, check_pairs, check_rotations
from graphgs.structure.quadrants import ACCEPTED, octant_codes, world_codes
from graphgs.structure.uncertainty import UNKNOWN, PoseUncertainty, of_reconstruction

FilterMode = Literal["paper-strict", "paper-loose", "octant", "frustum"]
# Full angle, one or (horizontal, vertical) for all cameras, or an array [N] or [N, 2]; NaN = unknown.
FieldOfView = float | tuple[float, float] | np.ndarray
# Near and far in world units, for all cameras or as an array [N, 2].
DepthRange = tuple[float, float] | np.ndarray

_LEAST_SHARED = 3  # points that both cameras of a pair are known to see: proof, wherever the poses say they stand
_CHUNK = 1 << 14  # pairs whose common points are counted at once


def filter_pairs(
    pairs: np.ndarray,  # [P, 2] int
    rotations: np.ndarray,  # [N, 3, 3] camera-from-world
    centers: np.ndarray,  # [N, 3] world
    *,
    mode: FilterMode = "frustum",
    fov_deg: FieldOfView | None = None,
    depth_range: DepthRange | None = None,
    points: np.ndarray | None = None,  # [K, 3] coarse points, world
    visible: np.ndarray | None = None,  # [V, 2] int: camera, point it sees
    uncertainty: PoseUncertainty | tuple[float, float] | None = None,  # (rad, world units), per axis and camera
) -> np.ndarray:
    """[P] bool: which pairs to keep. Protects nothing: connection pairs and nearest neighbours are the caller's care.

    paper-strict, paper-loose: the printed state table in WORLD axes, each pair judged as given, (i, j) is not (j, i).
        Turning the scene changes the answer.
    octant: the loose table with everything turned into the first camera's own frame; accepted if either order is.
    frustum: the overlap gate. What a camera is likely to see (samples of its frustum; with `points`, its own points
        and the depths they have in each part of its image) must fall into the other camera's image and depths, not
        behind what that one sees there; in either order (overlap.py). Three points seen by both are proof by
        themselves. Images are widened by `uncertainty`; not given, it is that of a coarse reconstruction where there
        are points, else 10 degrees between two cameras. Without a field of view for a camera its pairs are judged by
        `octant` (logged once). Without points or a depth range: near 0.5 and far 20 times the median spacing to the
        fifth neighbour. A tuple or list of two is fov_deg (horizontal, vertical) for all cameras.
    octant and frustum do not change with scale, rotation or translation of the scene.
    """
    centers = check_centers(centers)
    n = len(centers)
    rotations = check_rotations(rotations, n)
    pairs = check_pairs(pairs, n)
    if mode in ("paper-strict", "paper-loose"):
        return ACCEPTED[mode.removeprefix("paper-")][world_codes(pairs, rotations, centers)]
    if mode == "octant":
        return _octant(pairs, rotations, centers)
    if mode != "frustum":
        raise ValueError(f"mode: expected 'paper-strict', 'paper-loose', 'octant' or 'frustum', got {mode!r}")
    if not len(pairs):
        return np.zeros(0, bool)
    half_angle = _half_angles(fov_deg, n)
    points, visible = _points(points, visible, n)
    if uncertainty is None:
        uncertainty = UNKNOWN if points is None else of_reconstruction(centers)
    if depth_range is None and points is not None:
        camera, local = local_points(rotations, centers, points, visible)
        depth_range = depth_ranges(camera, local[:, 2], n)
    views = frustum_views(half_angle, _depth_ranges(depth_range, centers))
    known = np.isfinite(half_angle).all(1)[pairs].all(1)
    keep = np.zeros(len(pairs), bool)
    if points is not None:
        views = with_points(views, rotations, centers, points, visible)
        keep = _shared_points(pairs, visible, n) >= _LEAST_SHARED
    todo = np.flatnonzero(known & ~keep)
    keep[todo] = share_views(pairs[todo], rotations, centers, views, _uncertainty(uncertainty))
    if not known.all():
        _say_once("no field of view is known for some cameras: their pairs are filtered by octant instead of frustum")
        keep[~known] |= _octant(pairs[~known], rotations, centers)
    return keep


def _octant(pairs: np.ndarray, rotations: np.ndarray, centers: np.ndarray) -> np.ndarray:
    accepted = ACCEPTED["loose"]
    forward, backward = (octant_codes(p, rotations, centers) for p in (pairs, pairs[:, ::-1]))
    return accepted[forward] | accepted[backward]


def _shared_points(pairs: np.ndarray, visible: np.ndarray, n: int) -> np.ndarray:
    """[P] int: points that both cameras see."""
    visible = np.unique(visible, axis=0)
    count = int(visible[:, 1].max(initial=-1)) + 1
    seen = sparse.csr_matrix((np.ones(len(visible), np.int32), (visible[:, 0], visible[:, 1])), shape=(n, count))
    chunks = (pairs[start : start + _CHUNK].T for start in range(0, len(pairs), _CHUNK))
    return np.concatenate([np.asarray(seen[i].multiply(seen[j]).sum(1)).ravel() for i, j in chunks])


def _points(points, visible, n: int) -> tuple[np.ndarray, np.ndarray] | tuple[None, None]:
    """(points [K, 3], visible [V, 2]), or nothing; ValueError for anything else."""
    if points is None and visible is None:
        return None, None
    if points is None or visible is None:
        raise ValueError("points, visible: expected both or none")
    points, visible = np.asarray(points, np.float64), np.asarray(visible)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"points: expected [K, 3] finite numbers, got {list(points.shape)}")
    if visible.size == 0:
        return None, None
    if visible.ndim != 2 or visible.shape[1] != 2 or not np.issubdtype(visible.dtype, np.integer):
        raise ValueError(f"visible: expected [V, 2] int, got {list(visible.shape)} {visible.dtype}")
    if (visible < 0).any() or (visible >= [n, len(points)]).any():
        raise ValueError(f"visible: expected cameras below {n} and points below {len(points)}")
    return points, visible.astype(np.int64)


def _uncertainty(value) -> PoseUncertainty:
    rotation, position = (float(sigma) for sigma in value)
    if not (0 <= rotation < np.inf and 0 <= position < np.inf):
        raise ValueError(f"uncertainty: expected two finite numbers of 0 or more, got {rotation}, {position}")
    return PoseUncertainty(rotation, position)


def _half_angles(fov_deg, n: int) -> np.ndarray:
    """[N, 2] rad, NaN where unknown."""
    if fov_deg is None:
        return np.full((n, 2), np.nan)
    fov = np.asarray(fov_deg, np.float64)
    if fov.ndim == 1 and len(fov) == n and (n != 2 or isinstance(fov_deg, np.ndarray)):
        fov = fov[:, None]  # one per camera, the same both ways
    if fov.ndim > 2 or (fov.ndim == 1 and len(fov) != 2) or (fov.ndim == 2 and fov.shape not in ((n, 1), (n, 2))):
        raise ValueError(f"fov_deg: expected a number, (h, v), [{n}] or [{n}, 2], got {list(fov.shape)}")
    if ((fov <= 0) | (fov > 360)).any():
        raise ValueError(f"fov_deg: expected degrees in 0..360, got {np.nanmin(fov)}..{np.nanmax(fov)}")
    # A flat frustum ends before 180 degrees; a wider lens is judged as 160.
    return np.broadcast_to(np.deg2rad(np.minimum(fov, 160.0) / 2), (n, 2))


def _depth_ranges(depth_range, centers: np.ndarray) -> np.ndarray:
    """[N, 2] near and far."""
    n = len(centers)
    if depth_range is None:
        depth_range = np.array([0.5, 20.0]) * median_spacing(centers)
    depths = np.asarray(depth_range, np.float64)
    if depths.shape not in ((2,), (n, 2)):
        raise ValueError(f"depth_range: expected (near, far) or [{n}, 2], got {list(depths.shape)}")
    if not (np.isfinite(depths).all() and (depths[..., 0] >= 0).all() and (depths[..., 0] < depths[..., 1]).all()):
        raise ValueError("depth_range: expected 0 <= near < far")
    return np.broadcast_to(depths, (n, 2))


@functools.cache
def _say_once(message: str) -> None:
    logging.getLogger(__name__).warning(message)
