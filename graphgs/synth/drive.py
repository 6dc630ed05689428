"""The middle of the road and the drive along it: poses of a rig that sways, turns, nods and rolls a little.

A straight drive leaves the focal length unobservable, so the drive is not straight unless it is asked to be. World
frame: x right, y down, z forward at the start of the drive, metres, the ground at y = 0.
"""

from dataclasses import dataclass

import numpy as np

from graphgs.synth.course import Heading

UP = np.array([0.0, -1.0, 0.0])  # in the world
CAMERA_HEIGHT = 1.6  # [m]
SIDE_YAW_RAD = np.radians(45.0)  # of the left and right cameras
RIGS = {
    1: (("", 0.0, 0.0),),
    3: (("front", 0.0, 0.0), ("left", -SIDE_YAW_RAD, -0.4), ("right", SIDE_YAW_RAD, 0.4)),
}  # name, yaw, offset to the right [m]


class Centerline:
    """The middle of the road as a function of the distance driven, s [m]."""

    def __init__(self, start: float, end: float, heading: Heading):
        self.heading = heading
        self._s = np.arange(start, end, 0.02)
        step = 0.02 * np.stack([np.sin(self.heading(self._s)), np.cos(self.heading(self._s))], axis=1)
        self._xz = np.cumsum(step, axis=0)
        self._xz -= [np.interp(0.0, self._s, self._xz[:, 0]), np.interp(0.0, self._s, self._xz[:, 1])]

    def point(self, s: float, offset: float, height: float) -> np.ndarray:
        """[3] world point `offset` metres right of the centreline and `height` above the ground."""
        heading = self.heading(s)
        x, z = np.interp(s, self._s, self._xz[:, 0]), np.interp(s, self._s, self._xz[:, 1])
        return np.array([x + offset * np.cos(heading), -height, z - offset * np.sin(heading)])


@dataclass(frozen=True)
class Shot:
    """One photo to be taken."""

    name: str  # "000001" or "front/000001", without the suffix
    camera: int  # of the rig
    viewmat: np.ndarray  # [4, 4] world-to-camera


def plan_drive(
    centerline: Centerline, frames: int, cameras: int, spacing: float, seed: int, *, sway: float = 1.0
) -> list[Shot]:
    """The shots in the order they are taken: frame by frame, camera by camera. `sway` is the share of the vehicle's
    own motion; at 0 it follows the road as on rails."""
    phases = np.random.default_rng([seed, 1]).uniform(0, 2 * np.pi, 6)
    shots = []
    for frame in range(frames):
        s = frame * spacing
        aside, slope = _wave(s, 0.8 * sway, 7.0, phases[0])
        yaw = centerline.heading(s) + 0.3 * np.arctan(slope) + _wave(s, np.radians(4.0) * sway, 6.5, phases[1])[0]
        pitch = _wave(s, np.radians(1.5) * sway, 8.3, phases[2])[0]
        roll = _wave(s, np.radians(1.2) * sway, 5.1, phases[3])[0]
        height = CAMERA_HEIGHT + _wave(s, 0.2 * sway, 6.1, phases[4])[0]
        body = _about_y(yaw) @ _about_x(pitch) @ _about_z(roll)
        for camera, (folder, turn, shift) in enumerate(RIGS[cameras]):
            world_from_cam = body @ _about_y(turn)
            center = centerline.point(s, aside, height) + body[:, 0] * shift
            viewmat = np.eye(4)
            viewmat[:3, :3] = world_from_cam.T
            viewmat[:3, 3] = -world_from_cam.T @ center
            stem = f"{frame + 1:06d}"
            shots.append(Shot(f"{folder}/{stem}" if folder else stem, camera, viewmat))
    return shots


def _wave(s: float, amplitude: float, period: float, phase: float) -> tuple[float, float]:
    """(value, slope) of a sine over the distance driven."""
    angle = 2 * np.pi * s / period + phase
    return amplitude * np.sin(angle), amplitude * 2 * np.pi / period * np.cos(angle)


def _about_x(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def _about_y(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
