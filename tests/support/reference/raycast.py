"""Ray casting by trying every triangle (Moeller and Trumbore 1997), float64."""

import numpy as np


def depth_image(
    vertices: np.ndarray,  # [V, 3]
    triangles: np.ndarray,  # [F, 3] int
    viewmat: np.ndarray,  # [4, 4] world-to-camera
    K: np.ndarray,  # [3, 3] px
    width: int,
    height: int,
) -> tuple[np.ndarray, np.ndarray]:
    """(camera z [H, W], face [H, W]) at the pixel centres; 0 and -1 where nothing is hit."""
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([(columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1], np.ones_like(rows)], axis=-1)
    local = vertices @ viewmat[:3, :3].T + viewmat[:3, 3]
    depth, face = np.full((height, width), np.inf), np.full((height, width), -1)
    for f, (a, b, c) in enumerate(local[triangles]):
        across = np.cross(rays, c - a)
        determinant = across @ (b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (across @ -a) / determinant
            along = np.cross(-a, b - a)
            v = (rays @ along) / determinant
            z = ((c - a) @ along) / determinant
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (z > 0) & (z < depth)
        depth[hit], face[hit] = z[hit], f
    return np.where(face >= 0, depth, 0.0), face
