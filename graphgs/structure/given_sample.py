"""Some of the photos with given poses, chosen so that they overlap whether the poses are right or wrong."""

import dataclasses

import numpy as np

from graphgs.scene.names import as_counted
from graphgs.scene.neighbours import nearest
from graphgs.sources.photos import Photos

MOST = 64  # photos; up to so many, all are looked at
_PLACES = 6  # that a sample is taken at, evenly along the names
_BESIDE = 4  # photos taken at each: the next ones by name, and as many nearest ones by pose


def sample(
    names: tuple[str, ...],  # [N] of photos with a pose
    centers: np.ndarray,  # [N, 3] of their given poses
) -> np.ndarray:
    """[S] int, sorted, at most `MOST`: runs by name, for then photos overlap however wrong the poses are, and nearest
    neighbours by pose, for photos without an order overlap by place."""
    n = len(names)
    if n <= MOST:
        return np.arange(n)
    order = as_counted(names)
    beside = nearest(centers, _BESIDE)[0]
    chosen: set[int] = set()
    for start in np.linspace(0, n - 1 - _BESIDE, _PLACES).round().astype(int):
        run = order[start : start + _BESIDE + 1]
        chosen.update(run.tolist())
        chosen.update(beside[run[len(run) // 2]].tolist())
    return np.array(sorted(chosen), dtype=np.int64)


def sampled(photos: Photos, chosen: np.ndarray) -> Photos:
    """Only the photos of the given poses that are `chosen` ([S] int into `photos.given.names`), with their poses."""
    given = photos.given.of_images(chosen)
    wanted = set(given.names)
    return dataclasses.replace(
        photos, photos=tuple(p for p in photos.photos if p.name in wanted), given=given, skipped=(), rigs=()
    )
