"""Do two frusta share space? Judged by sample points of one that lie in the other."""

import numpy as np

_SAMPLES = 128
_CHUNK = 1 << 14  # pairs judged at once: 3 x 128 x 8 bytes each


def frusta_overlap(
    pairs: np.ndarray,  # [P, 2] int
    rotations: np.ndarray,  # [N, 3, 3] camera-from-world
    centers: np.ndarray,  # [N, 3]
    half_angle: np.ndarray,  # [N, 2] rad, horizontal and vertical
    depth_range: np.ndarray,  # [N, 2] near and far, world units
    *,
    margin: float = np.deg2rad(10.0),  # [rad] added to the half angles of the frustum that is looked into
    near_margin: float = 0.5,  # its near distance is multiplied by this
    far_margin: float = 1.2,  # and its far distance by this
    least: float = 0.02,  # more than this share of the samples must lie inside
) -> np.ndarray:
    """[P] bool: more than `least` of the samples of i's frustum lie in j's widened frustum, or the other way round.

    The margins cover coarse poses: with up to 0.3 rad and 0.3 camera spacings of noise, at least 99.9 % of the pairs
    that truly share a tenth of a frustum are kept (docs/decisions/0011-filters.md)."""
    keep = np.zeros(len(pairs), bool)
    for start in range(0, len(pairs), _CHUNK):
        part = slice(start, start + _CHUNK)
        for i, j in (pairs[part].T, pairs[part, ::-1].T):
            todo = np.flatnonzero(~keep[part])
            i, j = i[todo], j[todo]
            turn = rotations[j] @ rotations[i].transpose(0, 2, 1)
            move = np.einsum("pab,pb->pa", rotations[j], centers[i] - centers[j])
            x, y, z = np.moveaxis(turn @ _samples(half_angle[i], depth_range[i]) + move[..., None], 1, 0)
            slope = np.tan(np.minimum(half_angle[j] + margin, np.deg2rad(89.0)))[..., None]
            near, far = depth_range[j, :1] * near_margin, depth_range[j, 1:] * far_margin
            inside = (z >= near) & (z <= far) & (np.abs(x) <= slope[:, 0] * z) & (np.abs(y) <= slope[:, 1] * z)
            keep[start + todo] = inside.mean(1) > least
    return keep


def _samples(half_angle: np.ndarray, depth_range: np.ndarray) -> np.ndarray:
    """[P, 3, M] points of each frustum in its camera's frame: even over the image and over the depth range."""
    u, v, s = _SEQUENCE
    near, far = depth_range[:, :1], depth_range[:, 1:]
    z = near + (far - near) * s
    slope = np.tan(half_angle)
    return np.stack([u * slope[:, :1] * z, v * slope[:, 1:] * z, z], axis=1)


def _low_discrepancy(count: int) -> np.ndarray:
    """[3, count] even in -1..1, -1..1, 0..1: the R3 sequence (Roberts 2018, powers of the plastic number's 3-d kin)."""
    root = 1.2207440846057596  # x^4 = x + 1
    step = root ** -np.arange(1.0, 4.0)
    point = (0.5 + step[:, None] * np.arange(1, count + 1)) % 1.0
    return np.stack([2 * point[0] - 1, 2 * point[1] - 1, point[2]])


_SEQUENCE = _low_discrepancy(_SAMPLES)
