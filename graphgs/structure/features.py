"""SIFT features of all photos, extracted by as many worker processes as there are threads.

pycolmap's extractor holds Python's lock, so threads would not help; its own file-based extraction spends more time on
reading and shrinking images than on SIFT. Each photo leaves one file: a killed run loses at most one per worker. With a
cache, what was found once is not looked for again. A photo that ends its worker every time gets a file without features
that says so (`crashed_photos`).
"""

from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import ExitStack
from itertools import accumulate
from pathlib import Path
from queue import SimpleQueue

import numpy as np

from graphgs.sources.photos import Photo, Photos
from graphgs.structure.colmap import ColmapWorker, WorkerDied
from graphgs.structure.crashes import MOST_LOST, Crash
from graphgs.structure.feature_cache import FeatureCache

_POLL_S = 0.2  # between two reports


def extract_features(
    photos: Photos,
    folder: Path,  # gets <pixel file>.npz for each photo
    *,
    max_side: int,  # [px]
    max_features: int,
    first_octave: int,
    threads: int,
    progress: Callable[[int, int], None],
    cache: FeatureCache | None = None,
) -> np.ndarray:
    """Extract what is not there yet. Returns the number of features [N]."""
    settings = {"max_side": max_side, "max_features": max_features, "first_octave": first_octave}
    pending = [photo for photo in photos.photos if not (folder / f"{photo.pixels}.npz").exists()]
    if cache is None:
        _extract_around_crashes(photos, pending, folder, settings, threads, progress)
    else:
        cached = {photo.pixels: cache.path(photos, photo, settings) for photo in pending}
        pending = [p for p in pending if not cache.take(cached[p.pixels], folder / f"{p.pixels}.npz")]
        try:
            _extract_around_crashes(photos, pending, folder, settings, threads, progress)
        finally:
            crashed = {crash.photos[0] for crash in crashed_photos(photos, folder)}
            for photo in (p for p in pending if p.name not in crashed):
                cache.keep(folder / f"{photo.pixels}.npz", cached[photo.pixels])
            cache.prune()
    return np.array([len(_load(folder, photo.pixels, "keypoints")) for photo in photos.photos], dtype=np.int64)


def crashed_photos(photos: Photos, folder: Path) -> tuple[Crash, ...]:
    """The photos whose features in `folder` could not be found, as the search ends COLMAP's process."""
    found = []
    for photo in photos.photos:
        path = folder / f"{photo.pixels}.npz"
        if path.exists():
            with np.load(path, allow_pickle=False) as arrays:
                if "ended_by" in arrays:
                    found.append(Crash((photo.name,), str(arrays["ended_by"])))
    return tuple(found)


def _extract_around_crashes(
    photos: Photos,
    pending: list[Photo],
    folder: Path,
    settings: dict[str, int],
    threads: int,
    progress: Callable[[int, int], None],
) -> None:
    """Extract with all threads; if a worker dies of it, photo by photo, leaving out those that bring death."""
    try:
        return _extract(photos, pending, folder, settings, threads, progress)
    except WorkerDied:
        pass
    total, lost = len(photos.photos), 0
    pending = [photo for photo in pending if not (folder / f"{photo.pixels}.npz").exists()]
    with ColmapWorker(folder / "worker0") as worker:
        for k, photo in enumerate(pending):
            progress(total - len(pending) + k, total)
            try:
                worker.run("extract", **_job(photos, [photo], folder, settings))
            except WorkerDied as death:
                lost += 1
                if lost > MOST_LOST:
                    raise
                worker.restart(because=death.message)
                _without_features(folder / f"{photo.pixels}.npz", death.by)


def _without_features(path: Path, signal: str) -> None:
    partial = path.with_suffix(".partial.npz")
    nothing = {"keypoints": np.zeros((0, 4), np.float32), "descriptors": np.zeros((0, 128), np.uint8)}
    np.savez(partial, **nothing, ended_by=signal)
    partial.rename(path)


def _job(photos: Photos, chosen: list[Photo], folder: Path, settings: dict[str, int]) -> dict:
    """Arguments of the job `extract`."""
    return {
        "root": photos.folder,
        "images": [photo.pixels for photo in chosen],
        "masks": [photo.mask for photo in chosen],
        "out": folder,
        **settings,
    }


def _extract(
    photos: Photos,
    pending: list[Photo],
    folder: Path,
    settings: dict[str, int],
    threads: int,
    progress: Callable[[int, int], None],
) -> None:
    total = len(photos.photos)
    progress(total - len(pending), total)
    arrived: SimpleQueue[int] = SimpleQueue()  # one entry per photo; progress is told by this thread alone
    count = min(threads, len(pending))
    # The workers end first when something is raised here, which in turn ends the threads that wait for them.
    with ThreadPoolExecutor(max(1, count)) as pool, ExitStack() as stack:
        workers = [stack.enter_context(ColmapWorker(folder / f"worker{k}")) for k in range(count)]
        running = []
        for k, worker in enumerate(workers):
            job = _job(photos, pending[k::count], folder, settings)
            running.append(pool.submit(worker.run, "extract", progress=lambda done, _: arrived.put(done), **job))
        reported = 0
        while not all(future.done() for future in running):
            wait(running, timeout=_POLL_S, return_when=FIRST_EXCEPTION)
            if arrived.qsize() > reported:
                reported = arrived.qsize()
                progress(total - len(pending) + reported, total)
            for future in running:
                if future.done():
                    future.result()


def load_descriptors(photos: Photos, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """(descriptors [F, 128] uint8 of all photos in turn, offsets [N + 1])."""
    per_photo = [_load(folder, photo.pixels, "descriptors") for photo in photos.photos]
    return np.concatenate(per_photo), np.array(list(accumulate((len(d) for d in per_photo), initial=0)))


def _load(folder: Path, pixels: str, name: str) -> np.ndarray:
    with np.load(folder / f"{pixels}.npz", allow_pickle=False) as arrays:
        return arrays[name]
