"""The quadrant filter (GraphGS, section 3.2 and appendix): 64 states of relative position and orientation, a table.

World axes as printed. Proposition 1 of the paper, by which the code would be the true octant in the camera's frame,
does not hold: roll is not determined by the viewing direction. `octant_codes` gives the codes in camera i's own frame.
"""

import numpy as np

# Quadrant numbers as printed, by position bits (x, y, z) and by orientation bits (dot, cross x, cross y), 000..111.
POSITION_QUADRANT = (8, 7, 4, 3, 5, 6, 1, 2)
ORIENTATION_QUADRANT = (4, 1, 8, 5, 3, 2, 7, 6)

# Accepted orientation quadrants per position quadrant, as printed.
STRICT = {1: (7,), 2: (7, 8), 3: (5, 6), 4: (6,), 5: (3,), 6: (3, 4), 7: (1, 2), 8: (2,)}
LOOSE = {
    1: (2, 3, 6, 7),
    2: (2, 3, 4, 6, 7, 8),
    3: (1, 2, 3, 5, 6, 7),
    4: (2, 3, 6, 7),
    5: (2, 3, 6, 7),
    6: (2, 3, 4, 6, 7, 8),
    7: (1, 2, 3, 5, 6, 7),
    8: (2, 3, 6, 7),
}


def _by_code(table: dict[int, tuple[int, ...]]) -> np.ndarray:
    """[8, 8] bool: accepted, by position code and orientation code."""
    return np.array([[o in table[p] for o in ORIENTATION_QUADRANT] for p in POSITION_QUADRANT])


ACCEPTED = {"strict": _by_code(STRICT), "loose": _by_code(LOOSE)}


def world_codes(pairs: np.ndarray, rotations: np.ndarray, centers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(position code [P], orientation code [P]) in 0..7, in world axes: signs of p_j - p_i, and of d_i . d_j and the
    first two components of d_i x d_j. A sign is 1 only above zero."""
    i, j = pairs.T
    direction = rotations[:, 2]  # the camera's z axis in the world
    cross = np.cross(direction[i], direction[j])
    dot = (direction[i] * direction[j]).sum(1)
    return _code(centers[j] - centers[i]), _code(np.column_stack([dot, cross[:, :2]]))


def octant_codes(pairs: np.ndarray, rotations: np.ndarray, centers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`world_codes` with position and directions rotated into camera i's frame, where d_i = (0, 0, 1)."""
    i, j = pairs.T
    position = np.einsum("pab,pb->pa", rotations[i], centers[j] - centers[i])
    direction = np.einsum("pab,pb->pa", rotations[i], rotations[j, 2])
    # (0, 0, 1) x d = (-d.y, d.x, 0)
    return _code(position), _code(np.column_stack([direction[:, 2], -direction[:, 1], direction[:, 0]]))


def _code(vector: np.ndarray) -> np.ndarray:
    return (vector > 0) @ np.array([4, 2, 1])
