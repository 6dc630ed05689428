"""The verified matches themselves, as arrays: what a reconstruction is judged by.

Read straight from COLMAP's SQLite file, so that nothing waits for a worker and pycolmap stays out of this process.
"""

import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

_PAIR_ID_BASE = 2**31 - 1  # COLMAP: pair id = smaller image id * this + larger image id


@dataclass(frozen=True)
class VerifiedMatches:
    """Matches that passed two-view verification, pair after pair."""

    pairs: np.ndarray  # [E, 2] int, photo indices i < j, sorted
    offsets: np.ndarray  # [E + 1] rows of each pair below
    xy_i: np.ndarray  # [M, 2] float32 px, in the first photo of the pair
    xy_j: np.ndarray  # [M, 2] float32 px, in the second

    @property
    def pair_of(self) -> np.ndarray:
        """[M] int: the pair of each match."""
        return np.repeat(np.arange(len(self.pairs)), np.diff(self.offsets))


def read_verified(database: Path) -> VerifiedMatches:
    """All verified matches of a COLMAP database whose image i has the id i + 1."""
    with closing(sqlite3.connect(f"{database.resolve().as_uri()}?mode=ro", uri=True)) as connection:
        positions = {
            image_id - 1: np.frombuffer(data or b"", np.float32).reshape(rows, columns)[:, :2]
            for image_id, rows, columns, data in connection.execute("SELECT image_id, rows, cols, data FROM keypoints")
        }
        found = connection.execute(
            "SELECT pair_id, rows, data FROM two_view_geometries WHERE rows > 0 ORDER BY pair_id"
        ).fetchall()
    pairs = np.array([divmod(pair_id, _PAIR_ID_BASE) for pair_id, _, _ in found], np.int64).reshape(-1, 2) - 1
    offsets = np.concatenate([[0], np.cumsum([rows for _, rows, _ in found])]).astype(np.int64)
    xy_i, xy_j = np.zeros((offsets[-1], 2), np.float32), np.zeros((offsets[-1], 2), np.float32)
    for k, (_, rows, data) in enumerate(found):
        features = np.frombuffer(data, np.uint32).reshape(rows, 2)
        here = slice(offsets[k], offsets[k + 1])
        xy_i[here] = positions[int(pairs[k, 0])][features[:, 0]]
        xy_j[here] = positions[int(pairs[k, 1])][features[:, 1]]
    return VerifiedMatches(pairs, offsets, xy_i, xy_j)


@dataclass(frozen=True)
class TriedPairs:
    """Every pair that was matched, verified or not."""

    pairs: np.ndarray  # [T, 2] int, photo indices i < j, sorted
    matches: np.ndarray  # [T] features matched, before verification
    inliers: np.ndarray  # [T] of which verified


def read_tried(database: Path) -> TriedPairs:
    """Counts only: quick also where many pairs were matched."""
    with closing(sqlite3.connect(f"{database.resolve().as_uri()}?mode=ro", uri=True)) as connection:
        matches = dict(connection.execute("SELECT pair_id, rows FROM matches"))
        inliers = dict(connection.execute("SELECT pair_id, rows FROM two_view_geometries"))
    ids = sorted(matches.keys() | inliers.keys())
    pairs = np.array([divmod(pair_id, _PAIR_ID_BASE) for pair_id in ids], np.int64).reshape(-1, 2) - 1
    counts = [[found.get(pair_id, 0) for pair_id in ids] for found in (matches, inliers)]
    return TriedPairs(pairs, *(np.array(count, np.int64) for count in counts))
