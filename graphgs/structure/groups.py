"""The groups that photos fall into, by name, and the two photos that come closest to joining each to the kept one."""

from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np

from graphgs.structure.evidence import TriedPairs


@dataclass(frozen=True)
class Bridge:
    """Two photos, one of each group, between which further photos would help most."""

    here: str  # in the kept group
    there: str
    matches: int  # features matched between them, which fit no common geometry; 0 = not tried, they look alike

    def advice(self) -> str:
        tie = f"{self.matches} matches that fit no geometry" if self.matches else "they look alike"
        return f"take photos from {self.here} to {self.there} ({tie}), each overlapping the next by half or more"


@dataclass(frozen=True)
class Group:
    """Photos that hang together."""

    name: str
    photos: tuple[str, ...]
    bridge: Bridge | None = None  # None for the kept one, and where nothing at all is alike


def named_groups(
    names: tuple[str, ...],  # [N]
    members: list[np.ndarray],  # photo indices per group, the kept one first
    tried: TriedPairs,
    similar: np.ndarray,  # [N, k] look-alikes, best first, -1 = none
) -> tuple[Group, ...]:
    """Each under the name of its folder, where that is its own, or of its first and last photo."""
    folders = [_folder([names[i] for i in group]) for group in members]
    result = []
    for k, group in enumerate(members):
        photos = tuple(names[i] for i in group)
        unique = folders[k] and folders.count(folders[k]) == 1
        name = folders[k] if unique else f"{photos[0]} to {photos[-1]}" if len(photos) > 1 else photos[0]
        bridge = best_bridge(names, members[0], group, tried, similar) if k else None
        result.append(Group(name, photos, bridge))
    return tuple(result)


def best_bridge(
    names: tuple[str, ...], here: np.ndarray, there: np.ndarray, tried: TriedPairs, similar: np.ndarray
) -> Bridge | None:
    """The pair between two groups with the most matches, though they fit no geometry; else the one most alike."""
    side = np.zeros(len(names), np.int64)
    side[here], side[there] = 1, 2
    across = np.sort(side[tried.pairs], axis=1) == [1, 2]
    rows = np.flatnonzero(across.all(1) & (tried.matches > 0))
    if len(rows):
        row = rows[int(tried.matches[rows].argmax())]
        i, j = (int(k) for k in tried.pairs[row])
        return _bridge(names, side, i, j, int(tried.matches[row]))
    for rank in range(similar.shape[1] if similar.size else 0):
        for i in there:
            j = int(similar[i, rank])
            if j >= 0 and side[j] == 1:
                return _bridge(names, side, int(i), j, 0)
    return None


def _bridge(names: tuple[str, ...], side: np.ndarray, i: int, j: int, matches: int) -> Bridge:
    here, there = (i, j) if side[i] == 1 else (j, i)
    return Bridge(names[here], names[there], matches)


def _folder(photos: list[str]) -> str:
    """The folder that all of them lie in; empty at the top."""
    parents = {str(PurePosixPath(name).parent) for name in photos}
    only = parents.pop() if len(parents) == 1 else "."
    return "" if only == "." else only
