"""Sets of undirected pairs as arrays: i < j, unique, sorted lexicographically, each with its kinds."""

import numpy as np

NEIGHBOUR, RING, CONNECTION, EXTRA = 1, 2, 4, 8  # bits of `kinds`
KIND_NAMES = {NEIGHBOUR: "neighbour", RING: "ring", CONNECTION: "connection", EXTRA: "extra"}


def merge_pairs(
    parts: list[tuple[np.ndarray, np.ndarray | int]],  # ([P, 2] int in any order, [P] or one kind) each
    n: int,  # cameras
) -> tuple[np.ndarray, np.ndarray]:
    """One set from several: (pairs [P, 2] int64, kinds [P] uint8). Self-pairs go, kinds of duplicates are united."""
    codes = [np.zeros(0, np.int64)]
    for pairs, kind in parts:
        low, high = pairs.min(1, initial=n), pairs.max(1, initial=-1)
        # The pair and its kind in one number: sorting numbers is many times faster than sorting rows.
        code = ((low.astype(np.int64) * n + high) << 8) | np.asarray(kind, np.uint8)
        codes.append(code[low < high])
    code = np.concatenate(codes)
    if not len(code):
        return np.zeros((0, 2), np.int64), np.zeros(0, np.uint8)
    code.sort()
    kind, code = (code & 0xFF).astype(np.uint8), code >> 8
    first = np.flatnonzero(np.r_[True, code[1:] != code[:-1]])
    code = code[first]
    return np.stack([code // n, code % n], axis=1), np.bitwise_or.reduceat(kind, first)


def all_pairs(n: int) -> np.ndarray:
    """[N (N - 1) / 2, 2] every pair."""
    return np.stack(np.triu_indices(n, 1), axis=1).astype(np.int64)


def check_centers(centers: np.ndarray) -> np.ndarray:
    """[N, 3] float64, or ValueError."""
    centers = np.asarray(centers, np.float64)
    if centers.ndim != 2 or centers.shape[1] != 3:
        raise ValueError(f"centers: expected [N, 3], got {list(centers.shape)}")
    if not np.isfinite(centers).all():
        bad = np.flatnonzero(~np.isfinite(centers).all(1))
        raise ValueError(f"centers: expected finite numbers, camera {bad[0]} has {centers[bad[0]].tolist()}")
    return centers


def check_rotations(rotations: np.ndarray, n: int) -> np.ndarray:
    """[N, 3, 3] float64, or ValueError."""
    rotations = np.asarray(rotations, np.float64)
    if rotations.shape != (n, 3, 3):
        raise ValueError(f"rotations: expected [{n}, 3, 3], got {list(rotations.shape)}")
    if not np.isfinite(rotations).all():
        raise ValueError("rotations: expected finite numbers")
    return rotations


def check_pairs(pairs: np.ndarray, n: int, name: str = "pairs") -> np.ndarray:
    """[P, 2] int64 with indices below n, or ValueError."""
    pairs = np.asarray(pairs)
    if pairs.size == 0:
        return np.zeros((0, 2), np.int64)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or not np.issubdtype(pairs.dtype, np.integer):
        raise ValueError(f"{name}: expected [P, 2] int, got {list(pairs.shape)} {pairs.dtype}")
    if pairs.min() < 0 or pairs.max() >= n:
        raise ValueError(f"{name}: expected indices in 0..{n - 1}, got {pairs.min()}..{pairs.max()}")
    return pairs.astype(np.int64)
