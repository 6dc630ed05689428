"""How far the shape of a reconstruction is from the true one, in figures that name what is wrong with it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from bench.shape_truth import Truth
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import Similarity, align, align_robust, diameter

STRETCH_SHARE, STRETCH_LEAST = 8, 8  # a stretch is an eighth of the photos, at least eight of them
LIDAR_REACH = 0.3  # [m]


@dataclass(frozen=True)
class Measures:
    """Errors after one robust similarity; those that the truth cannot tell are None."""

    photos: int  # with a true pose
    placed: int  # of them
    diameter: float  # largest distance between true centres, in their unit
    position_median: float  # [% of the diameter], of the photos that were placed, as all below
    position_largest: float
    rotation_median: float | None  # [deg] of the relative rotation of every two photos
    rotation_p99: float | None
    focal: float | None  # [%] of the camera that is furthest off; positive is too long
    local_scale: float  # [%] of the stretch whose scale differs most from the whole's
    bend: float | None  # by how much the rim is too high against the middle (a bowl); negative: a dome; in truth's unit
    scatter: float | None  # standard deviation of the heights that bending leaves unexplained
    lidar_share: float | None = None  # [%] of the points within .3 m of a lidar point


def measure(model: Reconstruction, truth: Truth, *, lidar: np.ndarray | None = None) -> Measures:
    """Needs at least three photos that both know."""
    index = truth.index
    mine = np.array([k for k, name in enumerate(model.names) if name in index])
    true = np.array([index[model.names[k]] for k in mine])
    centers, target = model.centers[mine], truth.centers[true]
    size = diameter(truth.centers)
    world = align_robust(centers, target)
    off = world.apply(centers) - target
    distance = np.linalg.norm(off, axis=1)
    turned = None if truth.rotations is None else relative_rotations(model.rotations[mine], truth.rotations[true])
    bend, scatter = (None, None) if truth.up is None else bowl(target, off, truth.up)
    return Measures(
        photos=len(truth.names),
        placed=len(mine),
        diameter=size,
        position_median=100 * float(np.median(distance)) / size,
        position_largest=100 * float(distance.max()) / size,
        rotation_median=None if turned is None else float(np.median(turned)),
        rotation_p99=None if turned is None else float(np.percentile(turned, 99)),
        focal=None if truth.focals is None else focal_error(model, mine, truth.focals[true]),
        local_scale=worst_local_scale(centers, target, world),
        bend=bend,
        scatter=scatter,
        lidar_share=None if lidar is None else share_near(world.apply(model.points), lidar),
    )


def relative_rotations(
    rotations: np.ndarray,  # [N, 3, 3] camera-from-world
    truth: np.ndarray,  # [N, 3, 3] camera-from-another-world
) -> np.ndarray:
    """[N (N - 1) / 2] degrees by which the rotation between two photos is wrong; free of both worlds."""
    between = np.einsum("nba,nbc->nac", rotations, truth).reshape(-1, 9)  # equal for all photos if all is right
    i, j = np.triu_indices(len(between), 1)
    cosine = ((between[i] * between[j]).sum(1) - 1.0) / 2.0
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def focal_error(
    model: Reconstruction,
    images: np.ndarray,  # [N] int, of the model
    focals: np.ndarray,  # [N] focal length / picture width
) -> float:
    """[%] of the photo whose focal length is furthest off, with its sign."""
    cameras = [model.camera_of(k) for k in images]
    found = np.array([camera.focal_and_center[0] / camera.width for camera in cameras])
    errors = 100 * (found / focals - 1.0)
    return float(errors[np.abs(errors).argmax()])


def worst_local_scale(
    centers: np.ndarray,  # [N, 3] reconstructed
    target: np.ndarray,  # [N, 3] true
    world: Similarity,  # of all
) -> float:
    """[%] by which some stretch of the scene is too small (negative) or too large against the rest of it: every photo
    with its nearest neighbours makes a stretch, which is aligned on its own."""
    size = min(len(target), max(STRETCH_LEAST, len(target) // STRETCH_SHARE))
    _, stretches = cKDTree(target).query(target, k=size)
    ratios = np.array([world.scale / align(centers[s], target[s]).scale for s in stretches])
    return 100 * float(ratios[np.abs(np.log(np.maximum(ratios, 1e-9))).argmax()] - 1.0)


def bowl(
    target: np.ndarray,  # [N, 3] true
    off: np.ndarray,  # [N, 3] reconstructed and aligned, minus true
    up: np.ndarray,  # [3] unit
) -> tuple[float, float]:
    """(bend from the centre to the rim, scatter that remains): heights fitted with a plane and the squared distance
    from the centre. A positive bend is a bowl, a negative one a dome."""
    heights = off @ up
    flat = target - np.outer(target @ up, up)
    flat = flat - np.median(flat, axis=0)
    _, _, axes = np.linalg.svd(flat - flat.mean(0), full_matrices=False)
    squared = (flat**2).sum(1)
    unknowns = np.column_stack([np.ones(len(flat)), flat @ axes[:2].T, squared])
    fit, *_ = np.linalg.lstsq(unknowns, heights, rcond=None)
    return float(fit[3] * squared.max()), float((heights - unknowns @ fit).std())


def share_near(
    points: np.ndarray,  # [P, 3] m
    lidar: np.ndarray,  # [M, 3] m
) -> float:
    """[%] of the points that have a lidar point within reach."""
    if len(points) == 0:
        return 0.0
    distance, _ = cKDTree(lidar).query(points, distance_upper_bound=LIDAR_REACH)
    return 100 * float(np.isfinite(distance).mean())
