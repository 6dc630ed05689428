"""Cameras that move together: which photos belong side by side, and where the cameras sit on their rig.

Names only suggest a rig (`graphgs.sources.rigs`). It is one if the pose of each camera as seen from the first is the
same in nearly all frames; `RigPose` holds that pose and how much it varied.
"""

import dataclasses
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.rigs import Rig

_FEWEST_FRAMES = 3  # that two cameras need in common
_LARGEST_TURN_DEG = 1.0  # median deviation of a rigid camera's orientation
_LARGEST_MOVE = 0.1  # median deviation of its position, in baselines or steps between frames, whichever is longer
_ROUNDS = 50  # of the iteration for the median rotation


@dataclass(frozen=True)
class RigPose:
    """Where the cameras of a rig sit: medians over the frames of a reconstruction that have each beside the first."""

    folders: tuple[str, ...]  # [C]
    rotations: np.ndarray  # [C, 3, 3] cam_from_rig; the first camera is the rig's frame
    translations: np.ndarray  # [C, 3] cam_from_rig, world units
    frames: np.ndarray  # [C] int, frames seen by the camera and the first
    turn_deg: np.ndarray  # [C] median deviation of the orientation
    move: np.ndarray  # [C] median deviation of the position, world units
    rigid: bool  # all cameras are known, and kept their place

    @property
    def baselines(self) -> np.ndarray:
        """[C] distance of each camera from the first, world units."""
        return np.linalg.norm(self.translations, axis=1)

    def scaled(self, scale: float) -> "RigPose":
        """In a world that is larger by `scale`."""
        return dataclasses.replace(self, translations=self.translations * scale, move=self.move * scale)

    def describe(self, unit: str) -> str:
        """One line; `unit` of the world, "" if it has none."""
        name = f"rig {', '.join(self.folders)}"
        if not self.rigid:
            return f"{name}: the cameras do not keep their places, each photo has a pose of its own"
        angles = np.degrees(Rotation.from_matrix(self.rotations).magnitude())
        parts = [
            f"{folder} {baseline:.3f}{' ' + unit if unit else ''} and {angle:.2f} degrees from {self.folders[0]}"
            for folder, baseline, angle in zip(self.folders[1:], self.baselines[1:], angles[1:], strict=True)
        ]
        return f"{name}: {'; '.join(parts)}"

    def record(self) -> dict:
        """Plain values, for files and events."""
        angles = np.degrees(Rotation.from_matrix(self.rotations).magnitude())
        return {
            "folders": list(self.folders),
            "rigid": self.rigid,
            "baselines": [float(b) for b in self.baselines],
            "angles_deg": [float(a) for a in angles],
            "frames": [int(f) for f in self.frames],
            "position_deviations": [float(m) for m in self.move],
            "rotation_deviations_deg": [float(t) for t in self.turn_deg],
        }

    def save(self, path: Path) -> None:
        np.savez(path, **{f.name: np.asarray(getattr(self, f.name)) for f in dataclasses.fields(self)})

    @staticmethod
    def load(path: Path) -> "RigPose":
        with np.load(path, allow_pickle=False) as stored:
            arrays = dict(stored)
        folders, rigid = tuple(arrays.pop("folders").tolist()), bool(arrays.pop("rigid"))
        return RigPose(folders=folders, rigid=rigid, **arrays)


def sequences(n: int, rigs: tuple[Rig, ...]) -> list[np.ndarray]:
    """Photo indices in shooting order: each camera of a rig for itself, and all other photos as one row."""
    cameras = [column[column >= 0] for rig in rigs for column in rig.photos.T]
    alone = np.ones(n, dtype=bool)
    for camera in cameras:
        alone[camera] = False
    rest = np.flatnonzero(alone)
    return ([rest] if len(rest) else []) + cameras


def same_frame_pairs(rigs: tuple[Rig, ...]) -> np.ndarray:
    """[P, 2] photos that cameras of a rig took at the same moment."""
    parts = [rig.photos[:, list(pair)] for rig in rigs for pair in combinations(range(len(rig.folders)), 2)]
    pairs = np.concatenate(parts) if parts else np.zeros((0, 2), np.int64)
    return np.sort(pairs[(pairs >= 0).all(1)], axis=1)


def rig_pose(rig: Rig, names: tuple[str, ...], reconstruction: Reconstruction) -> RigPose:
    """The places of the cameras on the rig, robustly. `names` [N] are those that `rig.photos` counts."""
    row = {name: k for k, name in enumerate(reconstruction.names)}
    where = np.array([row.get(name, -1) for name in names] + [-1], dtype=np.int64)  # the last answers for "no photo"
    images = where[rig.photos]  # [F, C] into the reconstruction
    step = _step(reconstruction.centers, images[:, 0])
    count = len(rig.folders)
    rotations, translations = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    frames, turn, move = np.zeros(count, np.int64), np.zeros(count), np.zeros(count)
    frames[0] = (images[:, 0] >= 0).sum()
    for c in range(1, count):
        first, other = images[(images[:, [0, c]] >= 0).all(1)][:, [0, c]].T
        frames[c] = len(first)
        if not len(first):
            turn[c], move[c] = np.inf, np.inf
            continue
        relative = reconstruction.rotations[other] @ reconstruction.rotations[first].transpose(0, 2, 1)
        offset = reconstruction.centers[other] - reconstruction.centers[first]
        place = np.einsum("nij,nj->ni", reconstruction.rotations[first], offset)  # in the rig's frame
        rotations[c], middle = median_rotation(relative), np.median(place, axis=0)
        translations[c] = -rotations[c] @ middle
        deviation = Rotation.from_matrix(relative @ rotations[c].T).magnitude()
        turn[c] = np.degrees(np.median(deviation))
        move[c] = np.median(np.linalg.norm(place - middle, axis=1))
    reach = np.maximum(np.linalg.norm(translations, axis=1), step)
    rigid = (frames >= _FEWEST_FRAMES) & (turn < _LARGEST_TURN_DEG) & (move <= _LARGEST_MOVE * reach)
    return RigPose(rig.folders, rotations, translations, frames, turn, move, bool(rigid.all()))


def median_rotation(
    rotations: np.ndarray,  # [N, 3, 3]
) -> np.ndarray:
    """[3, 3] the rotation with the least sum of angles to all (Weiszfeld's iteration; Hartley et al. 2011)."""
    samples = Rotation.from_matrix(rotations)
    current = samples.mean()
    for _ in range(_ROUNDS):
        away = (samples * current.inv()).as_rotvec()
        weight = 1.0 / np.maximum(np.linalg.norm(away, axis=1), 1e-9)
        current = Rotation.from_rotvec((weight[:, None] * away).sum(0) / weight.sum()) * current
    return current.as_matrix()


def _step(centers: np.ndarray, images: np.ndarray) -> float:
    """Median distance between one frame and the next, of the first camera."""
    seen = images[images >= 0]
    return float(np.median(np.linalg.norm(np.diff(centers[seen], axis=0), axis=1))) if len(seen) > 1 else 0.0
