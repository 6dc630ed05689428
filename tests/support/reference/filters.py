"""The quadrant filter's closed forms, and the overlap of two frusta by plain sampling."""

import numpy as np


def accepted(mode: str, position: tuple[int, int, int], orientation: tuple[int, int, int]) -> bool:
    """The printed table in closed form; bits (x, y, z) and (dot, cross x, cross y)."""
    p_x, p_y, p_z = position
    dot, cross_x, cross_y = orientation
    d_x, d_y, d_z = cross_y, 1 - cross_x, dot
    if mode == "strict":
        return d_x != p_x and d_y != p_y and bool(p_z or d_z)
    return bool(d_z) or (bool(p_z) and d_x != p_x)


def overlap(
    i: int,
    j: int,
    rotations: np.ndarray,  # [N, 3, 3] camera-from-world
    centers: np.ndarray,  # [N, 3]
    *,
    fov_deg: float = 60.0,
    near: float = 0.5,
    far: float = 20.0,
    samples: int = 400,
) -> float:
    """Share of one frustum's random points that lie in the other, the larger of both ways."""
    rng = np.random.default_rng(7)
    u, v, s = rng.uniform(-1, 1, samples), rng.uniform(-1, 1, samples), rng.random(samples)
    z = near + (far - near) * s
    slope = np.tan(np.radians(fov_deg) / 2)
    own = np.stack([u * slope * z, v * slope * z, z], axis=1)
    share = 0.0
    for a, b in ((i, j), (j, i)):
        world = own @ rotations[a] + centers[a]
        x, y, depth = ((world - centers[b]) @ rotations[b].T).T
        inside = (depth >= near) & (depth <= far) & (np.abs(x) <= slope * depth) & (np.abs(y) <= slope * depth)
        share = max(share, float(inside.mean()))
    return share
