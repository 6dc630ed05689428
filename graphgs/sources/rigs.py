"""Cameras of a rig, told from names and sizes alone: sibling folders that hold the same frames.

left/000017.png and right/000017.png are one frame, so are cam0/a_17.jpg and cam1/b_17.jpg. Names can mislead (two walks
through a house, both numbered from 1): a rig found here only adds pairs, until its geometry confirms it
(`graphgs.structure.rigs`).
"""

import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np

from graphgs.sources.decode import same_shape

LEAST_SHARED = 0.8  # of the larger folder's frames
LEAST_FRAMES = 3
_INNER = {"data", "images", "rgb"}  # KITTI's image_02/data/: the camera is the folder above
# Words of folders whose pictures belong to the same frames and are no photos, or to another split of one camera's.
_NO_CAMERA = re.compile(
    r"(alpha|albedo|conf|confidence|depths?|disp|disparity|eval|flow|gt|instances?|labels?|masks?|normals?|renders?|seg"
    r"|segmentation|semantics?|test|thumbs|train|val|validation)"
)


@dataclass(frozen=True)
class Rig:
    """Cameras that move together, and the photos they took at the same moments."""

    folders: tuple[str, ...]  # [C] one per camera, sorted; the first is the reference
    photos: np.ndarray  # [F, C] int into the photos in order of name; -1: the camera has no photo of this frame

    @property
    def description(self) -> str:
        whole = int((self.photos >= 0).all(1).sum())
        return f"rig of {len(self.folders)} cameras ({', '.join(self.folders)}), {whole} frames in common"


def find_rigs(
    names: tuple[str, ...],
    sizes: np.ndarray,  # [N, 2] px
) -> tuple[Rig, ...]:
    """The rigs among photos. Conservative: cameras are sibling folders of at least 3 photos, all of one size, that have
    80 % of their frames in common, by the names of their files or by the numbers in them; folders named as masks,
    depths or data splits are none, nor are two of one shape at two sizes (reduced copies)."""
    folders = defaultdict(list)
    for i, name in enumerate(names):
        folders[str(PurePosixPath(name).parent)].append(i)
    siblings = defaultdict(list)
    for folder, members in sorted(folders.items()):
        if len(members) >= LEAST_FRAMES and _may_be_camera(folder) and len({tuple(sizes[i]) for i in members}) == 1:
            siblings[_place(folder)].append(folder)
    rigs = []
    for group in siblings.values():
        left = group
        for frames_of in (_by_stem, _by_number):
            frames = {folder: frames_of(names, folders[folder]) for folder in left}
            while cameras := _cameras(frames):
                originals = _originals(cameras, {folder: tuple(sizes[folders[folder][0]]) for folder in cameras})
                if len(originals) > 1:
                    rigs.append(_rig(originals, frames))
                    left = [folder for folder in left if folder not in cameras]
                frames = {folder: own for folder, own in frames.items() if folder not in cameras}
    return tuple(sorted(rigs, key=lambda rig: rig.folders))


def _may_be_camera(folder: str) -> bool:
    words = re.split(r"[^a-z]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", PurePosixPath(folder).name).lower())
    return not any(_NO_CAMERA.fullmatch(word) for word in words)


def _place(folder: str) -> tuple[str, str]:
    """Equal for folders that are siblings: what is above the camera's own folder, and what is below it."""
    path = PurePosixPath(folder)
    if path.name in _INNER and len(path.parts) > 1:
        return str(path.parent.parent), path.name
    return str(path.parent), "" if folder != "." else "."  # photos in the input folder itself have no siblings


def _by_stem(names: tuple[str, ...], members: list[int]) -> dict[str | int, int]:
    found = {PurePosixPath(names[i]).stem: i for i in members}
    return found if len(found) == len(members) else {}


def _by_number(names: tuple[str, ...], members: list[int]) -> dict[str | int, int]:
    """By the last number in the name, if that tells the photos of the folder apart."""
    digits = [re.findall(r"\d+", PurePosixPath(names[i]).stem) for i in members]
    found = {int(runs[-1]): i for runs, i in zip(digits, members, strict=True) if runs}
    return found if len(found) == len(members) else {}


def _cameras(frames: dict[str, dict]) -> tuple[str, ...]:
    """The folders that share their frames with the largest one that shares them with any."""
    for first in sorted(frames, key=lambda folder: (-len(frames[folder]), folder)):
        own = frames[first].keys()
        alike = [
            folder
            for folder, other in frames.items()
            if other and len(own & other.keys()) >= LEAST_SHARED * max(len(own), len(other))
        ]
        if len(alike) > 1:
            return tuple(sorted(alike))
    return ()


def _originals(cameras: tuple[str, ...], size_of: dict[str, tuple[int, int]]) -> tuple[str, ...]:
    """Without folders of the same shape as another at a smaller size, such as images_4/ beside images/."""

    def is_copy(folder: str) -> bool:
        own = size_of[folder]
        return any(own < other and same_shape(own, other) for other in size_of.values())

    return tuple(folder for folder in cameras if not is_copy(folder))


def _rig(cameras: tuple[str, ...], frames: dict[str, dict]) -> Rig:
    keys = sorted(set().union(*(own.keys() for own in frames.values())))
    photos = [[frames[camera].get(key, -1) for camera in cameras] for key in keys]
    return Rig(cameras, np.array(photos, dtype=np.int64))
