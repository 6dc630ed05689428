"""A dense cloud from the training photos: depths by plane sweep, kept where several views agree."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from graphgs.points.config import PointsConfig
from graphgs.points.dense_cloud import DenseCloud
from graphgs.points.partners import sweep_partners
from graphgs.points.swept_view import AGREEING, SmallView, SweptView
from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.views import Views

DEPTH_QUANTILES = (0.01, 0.99)  # of the sparse points a view sees: between is where its surfaces are known to be
NEARER, FARTHER = 0.6, 3.0  # the planes reach beyond that by these factors
FEWEST_POINTS = 20  # sparse points of a view; fewer say too little about its depths
MOST_PIXELS = 60e6  # of all photos together, 11 bytes each in memory: 1600 photos of 256 x 144; more are made smaller
MOST_POINTS = 1_000_000  # kept, the same number from each view


def dense_cloud(
    config: PointsConfig,
    reconstruction: Reconstruction,
    views: Views,  # in the reconstruction's order
    *,
    reporter: Reporter,
    threads: int,
    scratch: Path | None = None,  # depths found so far; a later call with the same arguments goes on from there
) -> DenseCloud:
    """Find surfaces in the training photos, reduced to at most `config.dense_max_side` px and to what memory holds.
    Held-out photos are not read.

    The same points for any number of threads. Empty where the photos share too little."""
    if config.dense == "none":
        return DenseCloud.empty()
    partners = sweep_partners(reconstruction, ~views.is_test, config.dense_partners)
    ranges = _depth_ranges(reconstruction)
    sweepable = [i for i in range(len(partners)) if len(partners[i]) >= AGREEING and ranges[i] is not None]
    needed = sorted({i for k in sweepable for i in (k, *partners[k].tolist())})
    factors = dict(zip(needed, _factors(views.sizes[np.array(needed, int)], config.dense_max_side), strict=True))
    most = -(-MOST_POINTS // max(1, len(sweepable)))
    with _workers(threads, reporter, total=len(needed) + 2 * len(sweepable)) as work:
        small = work(lambda i: SmallView.read(views, i, factors[i]), needed)
        swept = work(lambda i: _swept(small, i, partners[i], ranges[i], scratch), sweepable)
        parts = work(
            lambda i: swept[i].agreed([swept[j] for j in partners[i] if j in swept], most=most, seed=i), sweepable
        )
    reporter.event("dense", points=sum(len(part[0]) for part in parts.values()), photos=len(sweepable))
    if not parts:
        return DenseCloud.empty()
    found = {"views": np.array(sweepable), "pixels": np.array([1.0 / factors[i] for i in sweepable])}
    counts = [len(part[0]) for part in parts.values()]
    found = {name: np.repeat(values, counts) for name, values in found.items()}
    return DenseCloud(*map(np.concatenate, zip(*parts.values(), strict=True)), **found)


def _swept(
    small: dict[int, SmallView], i: int, partners: np.ndarray, depths: tuple[float, float], scratch: Path | None
) -> SweptView:
    """View i with its depths, which are kept in `scratch` once they are found."""
    kept = None if scratch is None else scratch / f"{i:06d}.npy"
    if kept is not None and kept.is_file():
        return SweptView(small[i], np.load(kept, allow_pickle=False))
    swept = small[i].swept([small[j] for j in partners], depths)
    if kept is not None:
        partial = kept.with_suffix(".partial.npy")
        np.save(partial, swept.inverse)
        partial.replace(kept)
    return swept


def _factors(sizes: np.ndarray, longest: int) -> list[float]:
    """By which photos of these sizes [N, 2] are reduced, one for each."""
    by_side = np.minimum(1.0, longest / sizes.max(axis=1, initial=1))
    by_memory = np.sqrt(MOST_PIXELS / max(1.0, float((sizes.prod(axis=1) * by_side**2).sum())))
    return (by_side * min(1.0, by_memory)).tolist()


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


@contextmanager
def _workers(threads: int, reporter: Reporter, *, total: int) -> Iterator[Callable]:
    """A function that does a piece of work for many views at a time and returns the results by view. OpenCV's own
    threads stay out of it: the views share the processors already."""
    done, opencv_threads = 0, cv2.getNumThreads()

    def work(function: Callable, rows: Iterable[int]) -> dict:
        nonlocal done
        results = {}
        for i, result in zip(rows, pool.map(function, rows), strict=True):
            results[i] = result
            done += 1
            reporter.progress(done, total, "looking for surfaces")
        return results

    cv2.setNumThreads(1)
    pool = ThreadPoolExecutor(threads)
    try:
        yield work
    finally:
        pool.shutdown(cancel_futures=True)  # who interrupts does not wait for all views
        cv2.setNumThreads(opencv_threads)
