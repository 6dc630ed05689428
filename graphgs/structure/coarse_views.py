"""What each camera is likely to see: samples of its frustum, and a coarse depth image where coarse points are known."""

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np

COLUMNS, ROWS = 8, 4  # cells of a coarse depth image
CELLS = COLUMNS * ROWS
_FRUSTUM_SAMPLES = 128
_OWN_SAMPLES = 32  # of a camera's own points
FEWEST_POINTS = 20  # a camera with fewer says nothing about its depths
DEPTH_PERCENTILES = (2.0, 98.0)  # of a camera's points: outliers must not stretch its frustum
_FAR_PERCENTILE = 95.0  # of the points in one cell: behind this lies what they hide
_CHUNK = 1 << 12  # cameras whose empty cells are filled at once


@dataclass(frozen=True)
class CoarseViews:
    """What is in sight of N cameras, K of which have a coarse depth image. Camera frames, world units."""

    slope: np.ndarray  # [N, 2] tangent of half the field of view, horizontal and vertical
    depth_range: np.ndarray  # [N, 2] near and far
    row: np.ndarray  # [N] int into the arrays below; -1: only the frustum is known
    seen: np.ndarray  # [K, S, 3] points likely in sight: one per cell, then some of the camera's own
    far: np.ndarray  # [K, CELLS] depth behind which a cell of the image shows nothing
    hull_slope: np.ndarray  # [N, 2] as `slope` and `depth_range`, but so that all samples lie within
    hull_depths: np.ndarray  # [N, 2]

    def has_points(self, cameras: np.ndarray) -> np.ndarray:
        """[C] bool."""
        return self.row[cameras] >= 0

    def samples(self, cameras: np.ndarray, block: slice) -> np.ndarray:
        """[C, 3, S] of cameras that all have points, or all have none: then even over the frustum."""
        if self.has_points(cameras).any():
            return self.seen[self.row[cameras], block].transpose(0, 2, 1)
        slope, depths = self.slope[cameras], self.depth_range[cameras]
        u, v, s = _SEQUENCE[:, block]
        samples = np.empty((len(cameras), 3, len(s)))
        samples[:, 2] = depths[:, :1] + (depths[:, 1:] - depths[:, :1]) * s
        samples[:, 0] = u * slope[:, :1] * samples[:, 2]
        samples[:, 1] = v * slope[:, 1:] * samples[:, 2]
        return samples

    def corners(self, cameras: np.ndarray) -> np.ndarray:
        """[C, 3, 8] of a frustum that holds all samples of a camera."""
        slope, depths = self.hull_slope[cameras], self.hull_depths[cameras]
        u, v, side = _CORNERS
        z = depths[:, side]
        return np.stack([u * slope[:, :1] * z, v * slope[:, 1:] * z, z], axis=1)

    @cached_property
    def reach(self) -> np.ndarray:
        """[N] distance that no sample of a camera exceeds."""
        return self.hull_depths[:, 1] * np.sqrt(1.0 + (self.hull_slope**2).sum(1))

    @cached_property
    def farthest(self) -> np.ndarray:
        """[N] the largest of a camera's far limits."""
        farthest = self.depth_range[:, 1].copy()
        if len(self.far):
            farthest[self.row >= 0] = self.far.max(1)
        return farthest

    def far_limits(
        self,
        cameras: np.ndarray,  # [C]
        points: np.ndarray,  # [C, 3, S] in their frames
    ) -> np.ndarray:
        """[C, S] depth of what the camera sees where a point in front of it falls; at the nearest edge if that is
        outside the image. [C, 1] where there are only frusta."""
        limits = self.depth_range[cameras, 1:]
        known = np.flatnonzero(self.has_points(cameras))
        if not len(known):
            return limits
        cameras, points = cameras[known], points[known]
        z = np.where(points[:, 2:] > 0, points[:, 2:], 1.0)
        uv = points[:, :2] / z / self.slope[cameras][..., None]
        cell = _cells(uv.transpose(1, 0, 2))
        limits = np.repeat(limits, points.shape[2], axis=1)
        limits[known] = np.take_along_axis(self.far[self.row[cameras]], cell, axis=1)
        return limits


def frustum_views(
    half_angle: np.ndarray,  # [N, 2] rad
    depth_range: np.ndarray,  # [N, 2]
) -> CoarseViews:
    """Nothing known but how wide and how far the cameras see."""
    slope, nothing = np.tan(half_angle), np.full(len(half_angle), -1)
    return CoarseViews(slope, depth_range, nothing, np.zeros((0, 0, 3)), np.zeros((0, CELLS)), slope, depth_range)


def with_points(
    views: CoarseViews,
    rotations: np.ndarray,  # [N, 3, 3] camera-from-world
    centers: np.ndarray,  # [N, 3]
    points: np.ndarray,  # [K, 3] world
    visible: np.ndarray,  # [V, 2] int: camera, point
) -> CoarseViews:
    """The views with a coarse depth image for every camera that has enough points in front of it.

    Cells without a point take the depth of the nearest one that has some. Half of the samples are the cells at the
    median depth of their points, so that a cluster of features does not stand for the image; half are own points."""
    n = len(centers)
    camera, local = local_points(rotations, centers, points, visible)
    camera, local = camera[ahead := local[:, 2] > 0], local[ahead]
    enough = np.bincount(camera, minlength=n) >= FEWEST_POINTS
    camera, local = camera[chosen := enough[camera]], local[chosen]
    row = np.where(enough, np.cumsum(enough) - 1, -1)
    k, slope = int(enough.sum()), views.slope[enough]
    tangents = (local[:, :2] / local[:, 2:] / views.slope[camera]).T
    cell = row[camera] * CELLS + _cells(tangents)
    order = np.lexsort((local[:, 2], cell))
    cell, local = cell[order], local[order]

    filled, start, count = np.unique(cell, return_index=True, return_counts=True)
    source = _nearest_filled(np.isin(np.arange(k * CELLS), filled).reshape(k, CELLS), slope)
    where = np.searchsorted(filled, source + CELLS * np.arange(k)[:, None])
    far = _at_percentile(local[:, 2], start, count, _FAR_PERCENTILE)[where]
    middle = _at_percentile(local[:, 2], start, count, 50.0)[where]
    grid = np.concatenate([_CELL_CENTERS * slope[:, None] * middle[..., None], middle[..., None]], axis=2)

    first = np.searchsorted(cell, CELLS * np.arange(k + 1))
    spread = (np.arange(_OWN_SAMPLES) + 0.5) / _OWN_SAMPLES
    own = local[(first[:-1, None] + spread * np.diff(first)[:, None]).astype(np.int64)]
    seen = np.concatenate([grid, own], axis=1)
    hull_slope, hull_depths = views.slope.copy(), views.depth_range.copy()
    hull_slope[enough] = np.abs(seen[..., :2] / seen[..., 2:]).max(1)
    hull_depths[enough] = np.stack([seen[..., 2].min(1), seen[..., 2].max(1)], axis=1)
    return dataclasses.replace(views, row=row, seen=seen, far=far, hull_slope=hull_slope, hull_depths=hull_depths)


def local_points(
    rotations: np.ndarray, centers: np.ndarray, points: np.ndarray, visible: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(camera [V], position in that camera's frame [V, 3]) of every observation."""
    camera, point = visible.T
    return camera, np.einsum("vab,vb->va", rotations[camera], points[point] - centers[camera])


def depth_ranges(camera: np.ndarray, depth: np.ndarray, n: int) -> np.ndarray | None:
    """[N, 2] near and far of what each camera sees, from the depths [V] of its points; a camera with few points takes
    those of all. None where no point lies in front of its camera."""
    camera, depth = camera[depth > 0], depth[depth > 0]
    if len(depth) == 0:
        return None
    count = np.bincount(camera, minlength=n)
    start = np.cumsum(count) - count
    enough = count >= FEWEST_POINTS
    depth_by_camera = depth[np.lexsort((depth, camera))]
    ranges = np.tile(np.percentile(depth, DEPTH_PERCENTILES), (n, 1))
    for side, percentile in enumerate(DEPTH_PERCENTILES):
        ranges[enough, side] = _at_percentile(depth_by_camera, start[enough], count[enough], percentile)
    ranges[:, 1] = np.maximum(ranges[:, 1], ranges[:, 0] * 1.01)
    return ranges


def _at_percentile(values: np.ndarray, start: np.ndarray, count: np.ndarray, percentile: float) -> np.ndarray:
    """Percentile of each run `values[start : start + count]`, sorted, by linear interpolation as NumPy's."""
    place = percentile / 100.0 * (count - 1)
    below = np.floor(place).astype(np.int64)
    above = np.minimum(below + 1, count - 1)
    return values[start + below] + (place - below) * (values[start + above] - values[start + below])


def _cells(uv: np.ndarray) -> np.ndarray:
    """Cell of each image position [2, ...] in -1..1; positions outside belong to the nearest edge."""
    column = np.clip((uv[0] + 1.0) * (0.5 * COLUMNS), 0, COLUMNS - 1).astype(np.int64)
    return np.clip((uv[1] + 1.0) * (0.5 * ROWS), 0, ROWS - 1).astype(np.int64) * COLUMNS + column


def _nearest_filled(filled: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """[K, CELLS] int: the nearest cell that has points ([K, CELLS] bool), by distance in the image."""
    apart = _CELL_CENTERS[:, None] - _CELL_CENTERS[None]
    result = np.empty(filled.shape, np.int64)
    for start in range(0, len(filled), _CHUNK):
        part = slice(start, start + _CHUNK)
        distance = (apart**2 @ (slope[part].T ** 2)).transpose(2, 0, 1)  # [C, CELLS, CELLS]
        result[part] = np.where(filled[part, None], distance, np.inf).argmin(2)
    return result


def _low_discrepancy(count: int) -> np.ndarray:
    """[3, count] even in -1..1, -1..1, 0..1: the R3 sequence (Roberts 2018, powers of the plastic number's 3-d kin)."""
    root = 1.2207440846057596  # x^4 = x + 1
    step = root ** -np.arange(1.0, 4.0)
    point = (0.5 + step[:, None] * np.arange(1, count + 1)) % 1.0
    return np.stack([2 * point[0] - 1, 2 * point[1] - 1, point[2]])


_SEQUENCE = _low_discrepancy(_FRUSTUM_SAMPLES)
_CORNERS = np.array([[-1, 1, -1, 1] * 2, [-1, -1, 1, 1] * 2, [0] * 4 + [1] * 4])  # image sides, and near or far
_CELL_CENTERS = np.stack(
    [
        (np.arange(CELLS) % COLUMNS + 0.5) * (2.0 / COLUMNS) - 1.0,
        (np.arange(CELLS) // COLUMNS + 0.5) * (2.0 / ROWS) - 1.0,
    ],
    axis=1,
)  # [CELLS, 2] in -1..1
