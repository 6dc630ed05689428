"""Do the verified matches fit the reconstruction? Where buildings repeat, a model may fold: two places become one, all
photos are placed, and every point it kept fits to a fraction of a pixel. What tells is what it did not keep: pairs of
photos with many verified matches that the model puts elsewhere (Zach et al. 2008 called it missing correspondences).
"""

from dataclasses import dataclass

import cv2
import numpy as np

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.evidence import VerifiedMatches

_FAR = 0.02  # of the longer side: a point that projects further from its match contradicts it; bundle errors are below
_GRID = 64  # steps per px in which positions are compared
_SPAN = 2**20  # of steps per axis


@dataclass(frozen=True)
class PairSupport:
    """What a reconstruction makes of the verified matches of each pair that it has both photos of."""

    pairs: np.ndarray  # [E, 2] int into the reconstruction's names
    matches: np.ndarray  # [E] verified
    supported: np.ndarray  # [E] of which a triangulated point projects to where it was matched
    contradicted: np.ndarray  # [E] of which every triangulated point projects elsewhere

    @property
    def contradicted_share(self) -> float:
        """Of all matches that the reconstruction has a point for."""
        judged = int(self.supported.sum() + self.contradicted.sum())
        return float(self.contradicted.sum()) / judged if judged else 0.0

    def strength(self, least: int) -> np.ndarray:
        """[E] contradicted matches relative to what the weaker photo of the pair has supported in its best pair, or to
        `least` where that is more. About 1: the two photos are tied as firmly as any, and not as the model has it."""
        n = int(self.pairs.max(initial=-1)) + 1
        best = np.full(n, float(least))
        for side in range(2):
            np.maximum.at(best, self.pairs[:, side], self.supported)
        return self.contradicted / best[self.pairs].min(1)

    def objections(self, least: int) -> np.ndarray:
        """[E] `strength` of the pairs that contradict the model with enough matches to be meant, else 0."""
        return self.strength(least) * (self.contradicted >= 2 * least)


def support_of(
    model: Reconstruction,
    names: tuple[str, ...],  # [N] photos that the matches count
    verified: VerifiedMatches,
) -> PairSupport:
    """Every match counts once. One is supported if the point of either of its features projects to the other one."""
    row = {name: k for k, name in enumerate(model.names)}
    image_of = np.array([row.get(name, -1) for name in names], np.int64)
    images = image_of[verified.pairs]  # [E, 2]
    pair_of = verified.pair_of
    posed = (images >= 0).all(1)
    chosen = np.flatnonzero(posed[pair_of])
    pair_of = (np.cumsum(posed) - 1)[pair_of[chosen]]
    images, ends = images[posed], (verified.xy_i[chosen], verified.xy_j[chosen])
    lookup = PointLookup(model)
    nearest, judged = np.full(len(chosen), np.inf), np.zeros(len(chosen), bool)
    for side in range(2):
        own, other = images[pair_of, side], images[pair_of, 1 - side]
        point = lookup.points(own, ends[side])
        has = np.flatnonzero(point >= 0)
        seen = project(model, other[has], model.points[point[has]])
        away = np.linalg.norm(seen - ends[1 - side][has], axis=1)
        nearest[has] = np.minimum(nearest[has], np.nan_to_num(away, nan=np.inf) / _longer_sides(model)[other[has]])
        judged[has] = True
    fits, count = nearest <= _FAR, len(images)
    return PairSupport(
        pairs=images,
        matches=np.bincount(pair_of, minlength=count),
        supported=np.bincount(pair_of[fits], minlength=count),
        contradicted=np.bincount(pair_of[judged & ~fits], minlength=count),
    )


class PointLookup:
    """The triangulated point at a feature, by the photo and the position of the feature."""

    def __init__(self, model: Reconstruction):
        keys = _keys(model.track_images, model.track_xy)
        order = np.argsort(keys, kind="stable")
        self._keys = keys[order]
        self._points = np.repeat(np.arange(len(model.points)), model.track_lengths)[order]

    def points(
        self,
        images: np.ndarray,  # [M] int into the model's names
        xy: np.ndarray,  # [M, 2] px
    ) -> np.ndarray:
        """[M] int, -1 where there is none."""
        if not len(self._keys):
            return np.full(len(images), -1, np.int64)
        wanted = _keys(images, xy)
        at = np.minimum(np.searchsorted(self._keys, wanted), len(self._keys) - 1)
        return np.where(self._keys[at] == wanted, self._points[at], -1)


def project(
    model: Reconstruction,
    images: np.ndarray,  # [M] int into the model's names
    points: np.ndarray,  # [M, 3] world
) -> np.ndarray:
    """[M, 2] px, lens distortion included; NaN behind the camera."""
    local = np.einsum("mij,mj->mi", model.rotations[images], points) + model.translations[images]
    seen = np.full((len(images), 2), np.nan)
    camera_ids = model.camera_ids[images]
    for camera_id in np.unique(camera_ids):
        rows = np.flatnonzero((camera_ids == camera_id) & (local[:, 2] > 0))
        if len(rows):
            seen[rows] = _project(model.cameras[int(camera_id)], local[rows])
    return seen


def _project(camera: Camera, local: np.ndarray) -> np.ndarray:
    if camera.is_fisheye:
        seen, _ = cv2.fisheye.projectPoints(local[:, None], np.zeros(3), np.zeros(3), camera.K, camera.distortion)
    else:
        seen, _ = cv2.projectPoints(local, np.zeros(3), np.zeros(3), camera.K, camera.distortion)
    return seen.reshape(-1, 2)


def _keys(images: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """[M] int64: photo and position as one number."""
    steps = np.rint(np.asarray(xy, np.float64) * _GRID).astype(np.int64)
    return (np.asarray(images, np.int64) * _SPAN + steps[:, 0]) * _SPAN + steps[:, 1]


def _longer_sides(model: Reconstruction) -> np.ndarray:
    """[N] px of each photo."""
    return np.array([max(camera.width, camera.height) for camera in model.cameras])[model.camera_ids]
