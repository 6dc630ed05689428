"""The course of a street: how the road's heading changes with the distance driven.

A course decides what photos can tell about their camera: turning shows the focal length, driving straight on does not.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np

CourseName = Literal["winding", "bend", "corner", "straight"]
WINDING_RAD = 0.30  # largest turn of a winding street away from its first heading
WINDING_LENGTH = 80.0  # [m] period of its bends
BEND_RAD = np.radians(30.0)  # turned over the whole drive
CORNER_RAD = np.radians(90.0)
CORNER_LENGTH = 32.0  # [m] of the curve; its tightest radius is 13.6 m, beyond the footways and the house fronts

Heading = Callable[[np.ndarray], np.ndarray]  # s [m] -> angle about the vertical, 0 = +z, positive to the right


def heading_of(course: CourseName, drive_length: float, seed: int) -> Heading:
    """The heading along a course, zero where the drive starts; the seed says to which side it turns."""
    rng = np.random.default_rng([seed, 2])
    if course == "straight":
        return np.zeros_like
    if course == "winding":
        phase = rng.uniform(0, 2 * np.pi)
        return lambda s: WINDING_RAD * (np.sin(2 * np.pi * s / WINDING_LENGTH + phase) - np.sin(phase))
    turn, length = (BEND_RAD, drive_length) if course == "bend" else (CORNER_RAD, CORNER_LENGTH)
    side, start = rng.choice([-1.0, 1.0]), (drive_length - length) / 2

    def heading(s):
        t = np.clip((s - start) / length, 0.0, 1.0)
        return side * turn * t * t * (3.0 - 2.0 * t)  # curvature grows and falls steadily, as roads are laid out

    return heading
