"""Were the photos taken from one spot? Then a turn of the camera alone explains all matches, there is no depth to be
found, and any reconstruction is an invention: with a wrong focal length it even places every photo.
"""

from dataclasses import dataclass

import numpy as np

from graphgs.structure.cameras import SharedCameras
from graphgs.structure.evidence import VerifiedMatches

_SCALES = np.geomspace(0.4, 4.0, 36)  # of the focal length believed so far
_NEARLY = 1.43  # a focal length that the photos tell is right to this factor; if not, a turn must show it
_CLOSE, _CLOSEST_PX = 0.002, 1.0  # of the longer side: a match that a turn explains; features are that precise
_MOST_PAIRS, _MOST_MATCHES = 200, 200  # looked at, per pair
_ROUNDS = 4  # of reweighting
_TURNED = 0.8  # share of a pair's matches that a turn must explain
LARGEST_TURNING_SHARE = 0.9  # of the pairs; photos from several spots, turned on each, are tied by the others


@dataclass(frozen=True)
class RotationFit:
    """How well turning on the spot explains the matches, at the focal length where it does so best."""

    share: float  # of the pairs that a turn explains nearly all matches of
    focal_scale: float  # of the focal length believed so far
    open: bool = False  # it does so at the longest focal length too, where a walk along a plane looks the same

    @property
    def on_the_spot(self) -> bool:
        return self.share >= LARGEST_TURNING_SHARE

    def describe(self) -> str:
        """What being on the spot means, for people."""
        pairs = f"({100 * self.share:.0f} % of the pairs of photos need no more than that)"
        if self.open:
            return (
                f"a turn on the spot would explain the photos {pairs}, and so would a walk along a plane, which leaves "
                "the focal length open"
            )
        return f"the camera only turned on the spot, or did not move {pairs}, so there is no depth in the photos"


def fit_rotations(verified: VerifiedMatches, cameras: SharedCameras, *, focal_known: bool) -> RotationFit:
    """One rotation per pair and one factor for all focal lengths; lens distortion is left out.

    A walk along a plane is explained the better the longer the focal length, a turn at its true one. So a focal length
    that the photos tell (`focal_known`) may be wrong by any factor, unless the longest one explains them as well."""
    chosen, starts = _sample(verified)
    if not len(chosen):
        return RotationFit(0.0, 1.0)
    pair_of = verified.pair_of[chosen]
    intrinsics = np.array(
        [(*camera.focal_and_center[1:], max(camera.width, camera.height)) for camera in cameras.cameras]
    )
    f_i, f_j = (intrinsics[cameras.camera_ids[verified.pairs[pair_of, side]]] for side in range(2))
    shares = np.array(
        [_explained(verified.xy_i[chosen], verified.xy_j[chosen], f_i, f_j, scale, starts) for scale in _SCALES]
    )
    endless = bool(shares[-1] >= LARGEST_TURNING_SHARE)
    if focal_known and endless:
        shares = np.where(np.abs(np.log(_SCALES)) <= np.log(_NEARLY), shares, 0.0)
    best = int(shares.argmax())
    return RotationFit(float(shares[best]), float(_SCALES[best]), endless and not focal_known)


def _sample(verified: VerifiedMatches) -> tuple[np.ndarray, np.ndarray]:
    """(rows of the matches looked at, where each pair begins among them): evenly spread, so without any draw."""
    count = len(verified.pairs)
    pairs = np.unique(np.linspace(0, count - 1, min(count, _MOST_PAIRS)).round().astype(int)) if count else []
    rows = []
    for k in pairs:
        first, last = verified.offsets[k], verified.offsets[k + 1]
        rows.append(np.unique(np.linspace(first, last - 1, min(last - first, _MOST_MATCHES)).round().astype(np.int64)))
    if not rows:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    return np.concatenate(rows), np.concatenate([[0], np.cumsum([len(r) for r in rows])[:-1]]).astype(np.int64)


def _explained(
    xy_i: np.ndarray,  # [M, 2] px
    xy_j: np.ndarray,  # [M, 2] px
    intrinsics_i: np.ndarray,  # [M, 4] focal length, principal point, longer side
    intrinsics_j: np.ndarray,  # [M, 4]
    scale: float,
    starts: np.ndarray,  # [E] first match of each pair
) -> float:
    """Share of the pairs whose best rotation carries nearly all matches onto each other."""
    rays_i, rays_j = _rays(xy_i, intrinsics_i, scale), _rays(xy_j, intrinsics_j, scale)
    pair = np.repeat(np.arange(len(starts)), np.diff([*starts, len(xy_i)]))
    limit = np.maximum(_CLOSE * intrinsics_j[:, 3], _CLOSEST_PX)
    weight = np.ones(len(xy_i))
    for _ in range(_ROUNDS):
        moments = np.add.reduceat((weight[:, None] * rays_j)[:, :, None] * rays_i[:, None, :], starts)
        u, _, vt = np.linalg.svd(moments)
        u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
        turned = np.einsum("mij,mj->mi", (u @ vt)[pair], rays_i)
        front = np.maximum(turned[:, 2:], 1e-9)
        seen = turned[:, :2] / front * (scale * intrinsics_j[:, :1]) + intrinsics_j[:, 1:3]
        error = np.linalg.norm(seen - xy_j, axis=1) / limit
        weight = 1.0 / (1.0 + error**2)
    explained = np.add.reduceat(error < 1.0, starts, dtype=np.int64) / np.bincount(pair)
    return float((explained >= _TURNED).mean())


def _rays(xy: np.ndarray, intrinsics: np.ndarray, scale: float) -> np.ndarray:
    """[M, 3] unit vectors in the camera."""
    rays = np.column_stack([(xy - intrinsics[:, 1:3]) / (scale * intrinsics[:, :1]), np.ones(len(xy))])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)
