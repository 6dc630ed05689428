"""A dense cloud from the training photos: depths by plane sweep, kept where several views agree."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from graphgs.points.config import PointsConfig
from graphgs.points.partners import sweep_partners
from graphgs.points.plane_sweep import PosedImage, sweep
from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.views import Views

DEPTH_QUANTILES = (0.01, 0.99)  # of the sparse points a view sees: between is where its surfaces are known to be
NEARER, FARTHER = 0.6, 3.0  # the planes reach beyond that by these factors
FEWEST_POINTS = 20  # sparse points of a view; fewer say too little about its depths
AGREEING = 2  # partners that must find the same surface
TOLERANCE = 0.01  # of its depth
MOST_PIXELS = 60e6  # of all photos together, 11 bytes each in memory: 1600 photos of 256 x 144; more are made smaller
MOST_POINTS = 1_000_000  # kept, the same number from each view


@dataclass(frozen=True)
class DenseCloud:
    """Points on surfaces that at least three training photos show."""

    positions: np.ndarray  # [D, 3] world
    colors: np.ndarray  # [D, 3] uint8 RGB
    track_lengths: np.ndarray  # [D] int, photos that agree
    views: np.ndarray  # [D] int, the view that each was found in
    pixel: float  # side of the pixels compared, in pixels of the training images

    @staticmethod
    def empty() -> "DenseCloud":
        return DenseCloud(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0, int), np.zeros(0, int), 1.0)

    def __len__(self) -> int:
        return len(self.positions)

    def of_views(self, rows: np.ndarray) -> "DenseCloud":
        """What was found in these views, which are then numbered 0, 1, ..."""
        number = np.full(max(rows.max(initial=-1), self.views.max(initial=-1)) + 1, -1)
        number[rows] = np.arange(len(rows))
        kept = number[self.views] >= 0
        fields = (self.positions, self.colors, self.track_lengths)
        return DenseCloud(*(field[kept] for field in fields), number[self.views[kept]], self.pixel)

    def save(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(
            folder / "dense.npz", positions=self.positions, colors=self.colors,
            track_lengths=self.track_lengths, views=self.views, pixel=self.pixel,
        )  # fmt: skip

    @staticmethod
    def load(folder: Path) -> "DenseCloud":
        with np.load(folder / "dense.npz", allow_pickle=False) as arrays:
            fields = dict(arrays)
        return DenseCloud(**{**fields, "pixel": float(fields["pixel"])})


def dense_cloud(
    config: PointsConfig,
    reconstruction: Reconstruction,
    views: Views,  # in the reconstruction's order
    *,
    reporter: Reporter,
    threads: int,
) -> DenseCloud:
    """Find surfaces in the training photos, reduced to at most `config.dense_max_side` px and to what memory holds.
    Held-out photos are not read.

    The same points for any number of threads. Empty where the photos share too little."""
    if config.dense == "none":
        return DenseCloud.empty()
    training = np.flatnonzero(~views.is_test)
    partners = sweep_partners(reconstruction, ~views.is_test, config.dense_partners)
    ranges = _depth_ranges(reconstruction)
    factor = _factor(views.sizes[training], config.dense_max_side)
    total = 3 * len(training)

    with ThreadPoolExecutor(threads) as pool:

        def all_of(work, rows, before: int) -> list:
            results = []
            for done, result in enumerate(pool.map(work, rows), before + 1):
                results.append(result)
                reporter.progress(done, total, "looking for surfaces")
            return results

        small = dict(zip(training, all_of(lambda i: _reduced(views, i, factor), training, 0), strict=True))

        def depths_of(i: int) -> np.ndarray | None:
            if not len(partners[i]) or ranges[i] is None:
                return None
            photo = small[i]
            inverse = sweep(photo.posed, [small[j].posed for j in partners[i]], ranges[i])
            return inverse if photo.mask is None else np.where(photo.mask, inverse, np.float32(0.0))

        found = dict(zip(training, all_of(depths_of, training, len(training)), strict=True))
        most = -(-MOST_POINTS // max(1, len(training)))

        def points_of(i: int):
            if found[i] is None:
                return np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0, int)
            others = [(small[j].posed, found[j]) for j in partners[i] if found[j] is not None]
            return _agreed(small[i], found[i], others, most=most, seed=int(i))

        parts = all_of(points_of, training, 2 * len(training))
    found_in = np.repeat(training, [len(positions) for positions, *_ in parts])
    cloud = DenseCloud(*map(np.concatenate, zip(*parts, strict=True)), found_in, pixel=1.0 / factor)
    reporter.event("dense", points=len(cloud), photos=sum(depths is not None for depths in found.values()))
    return cloud


@dataclass(frozen=True)
class _Small:
    """A training photo at the size it is swept at."""

    posed: PosedImage
    colors: np.ndarray  # [H, W, 3] uint8 RGB
    mask: np.ndarray | None  # [H, W] bool: what counts


def _factor(sizes: np.ndarray, longest: int) -> float:
    """By which photos of these sizes [N, 2] are reduced."""
    by_side = longest / max(1, int(sizes.max(initial=1)))
    by_memory = np.sqrt(MOST_PIXELS / max(1.0, float(sizes.prod(axis=1).sum())))
    return float(min(1.0, by_side, by_memory))


def _reduced(views: Views, i: int, factor: float) -> _Small:
    image, mask = views.read(i)
    height, width = image.shape[:2]
    size = (max(1, round(factor * width)), max(1, round(factor * height)))
    colors = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    if mask is not None:  # a pixel counts where all of it does
        mask = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.999
    K = np.diag([size[0] / width, size[1] / height, 1.0]) @ views.Ks[i]
    gray = cv2.cvtColor(colors, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return _Small(PosedImage(gray, K, views.viewmats[i]), colors, mask)


def _depth_ranges(reconstruction: Reconstruction) -> list[tuple[float, float] | None]:
    """Camera z of the nearest and the farthest plane of each image; None where too few points say where."""
    point = np.repeat(np.arange(len(reconstruction.points)), reconstruction.track_lengths)
    by_image = np.argsort(reconstruction.track_images, kind="stable")
    bounds = np.searchsorted(reconstruction.track_images[by_image], np.arange(len(reconstruction.names) + 1))
    ranges = []
    for i, (start, end) in enumerate(pairwise(bounds)):
        seen = reconstruction.points[point[by_image[start:end]]]
        depth = seen @ reconstruction.rotations[i, 2] + reconstruction.translations[i, 2]
        depth = depth[depth > 0]
        if len(depth) < FEWEST_POINTS:
            ranges.append(None)
            continue
        near, far = np.quantile(depth, DEPTH_QUANTILES)
        ranges.append((NEARER * float(near), FARTHER * float(far)))
    return ranges


def _agreed(
    photo: _Small,
    inverse: np.ndarray,  # [H, W] 1 / camera z, 0 = not known
    others: list[tuple[PosedImage, np.ndarray]],  # partners with theirs
    *,
    most: int,
    seed: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(positions [P, 3] world, colors [P, 3], photos that agree [P]) of the pixels whose surface partners find, too."""
    rows, columns = np.nonzero(inverse)
    posed = photo.posed
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    in_camera = pixels @ np.linalg.inv(posed.K).T / inverse[rows, columns, None]
    world = (in_camera - posed.viewmat[:3, 3]) @ posed.viewmat[:3, :3]
    agreeing = sum((_finds(world, *other).astype(int) for other in others), np.zeros(len(world), int))
    kept = np.flatnonzero(agreeing >= AGREEING)
    if len(kept) > most:
        kept = np.sort(np.random.default_rng(seed).choice(kept, most, replace=False))
    return world[kept], photo.colors[rows[kept], columns[kept]], agreeing[kept] + 1


def _finds(
    world: np.ndarray,  # [P, 3]
    posed: PosedImage,
    inverse: np.ndarray,  # [H, W] 1 / camera z, 0 = not known
) -> np.ndarray:  # [P] bool
    """Whether a view has a surface at these points."""
    in_camera = world @ posed.viewmat[:3, :3].T + posed.viewmat[:3, 3]
    depth = in_camera[:, 2]
    projected = in_camera @ posed.K.T
    columns, rows = np.floor(projected[:, :2] / np.maximum(projected[:, 2:], 1e-12)).T
    height, width = inverse.shape
    inside = (depth > 0) & (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    found = np.zeros(len(world))
    found[inside] = inverse[rows[inside].astype(int), columns[inside].astype(int)]
    return (found > 0) & (np.abs(found * depth - 1.0) < TOLERANCE)
