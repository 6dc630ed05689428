"""How well poses and points fit matches that were found without them.

A match says of two poses that its two rays meet in front of both cameras. How far they miss is measured as an angle
and told in pixels of the photo, lens distortion undone. Three things make that a test that wrong poses fail:

- rays that miss (the epipolar distance: Sampson's, of unit rays, so that it holds for fisheyes too);
- rays that meet behind a camera, which is all that tells forwards from backwards on a straight drive;
- the depth that the other photos give a feature: where each pair for itself would fit, as on a straight drive whose
  poses are permuted, the depths do not.

A match that the turn between the poses alone explains (the homography at infinity, within `FAR`) fits, whatever the
baseline: where there is little parallax, the rotation is what can be tested.
"""

from dataclasses import dataclass

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.evidence import VerifiedMatches
from graphgs.structure.undistort import image_rays

_STEPS_PER_PX = 64  # in which positions of features are compared

# Of the longer side. Features found at 640 px are right to a pixel, .16 %, and verification lets pass .25 % of 1600 px:
# what is .5 % off is neither. Matches that move less cannot be told from matches at infinity.
FAR = 0.005
NOT_NEAR = 0.02  # further off than bundle adjustment, which begins with 8 px of 640 to 1600, can pull back


@dataclass(frozen=True)
class Errors:
    """How far each of some observations is from what poses expect of it."""

    error: np.ndarray  # [M] of the photo's longer side
    side_px: np.ndarray  # [M] that side

    def further_than(self, limit: float) -> float:
        """Share of the observations that are further off, as a share of the longer side."""
        return float((self.error > limit).mean()) if len(self.error) else 0.0

    @property
    def median(self) -> float:
        """Of the longer side."""
        return float(np.median(self.error)) if len(self.error) else 0.0

    @property
    def median_px(self) -> float:
        return float(np.median(self.error * self.side_px)) if len(self.error) else 0.0


@dataclass(frozen=True)
class Sightings:
    """Features that several photos matched, seen from one of them, with the distance that the poses give them."""

    image: np.ndarray  # [K] int
    ray: np.ndarray  # [K, 3] unit, in the camera frame
    distance: np.ndarray  # [K] along it, world units


class MatchedRays:
    """The matches of a set of photos as unit rays: what depends on intrinsics, not on poses."""

    def __init__(
        self,
        model: Reconstruction,
        verified: VerifiedMatches,  # pairs count the names of `model`
        sides_px: np.ndarray,  # [N] longer side of each photo, as its file has it
    ):
        self.pairs, self.pair_of = verified.pairs, verified.pair_of
        self.images = verified.pairs[self.pair_of]  # [M, 2]
        xy = (verified.xy_i, verified.xy_j)
        self.rays = np.stack([_unit_rays(model, self.images[:, k], xy[k]) for k in range(2)], axis=1)  # [M, 2, 3]
        focal = np.array([np.mean(camera.focal_and_center[:2]) for camera in model.cameras])[model.camera_ids]
        side = np.array([max(camera.width, camera.height) for camera in model.cameras])[model.camera_ids]
        self._sides_per_rad = (focal / side)[self.images].mean(1)
        self._side_px = np.asarray(sides_px, float)[self.images].mean(1)
        ends = np.concatenate([self.images[:, 0], self.images[:, 1]]), np.rint(np.concatenate(xy) * _STEPS_PER_PX)
        keys = np.column_stack(ends).astype(np.int64)
        self.feature = np.unique(keys, axis=0, return_inverse=True)[1].reshape(2, -1).T  # [M, 2] int

    def errors(self, poses: Reconstruction) -> Errors:
        """Of every match. The intrinsics of `poses` are those the rays were made with."""
        two = _TwoViews.of(poses, self)
        expected = two.inverse_depths(self)
        several = np.bincount(self.feature.ravel(), minlength=len(expected)) > 1
        expected = np.where(several, expected, np.nan)[self.feature]  # [M, 2]
        ahead = np.einsum("mab,mb->ma", two.rotation, self.rays[:, 0]) + expected[:, :1] * two.shift
        back = np.einsum("mba,mb->ma", two.rotation, self.rays[:, 1] - expected[:, 1:] * two.shift)
        # By the better of its two features: one may have its depth from wrong matches.
        away = np.fmin(_angle(_unit(ahead), self.rays[:, 1]), _angle(_unit(back), self.rays[:, 0]))
        against_the_rest = np.nan_to_num(away) * self._sides_per_rad
        return Errors(np.maximum(np.minimum(two.turned, two.met), against_the_rest), self._side_px)

    def astray(self, errors: Errors, limit: float) -> float:
        """Share of the photos that no pair bears out: whose best pair has hardly half as many matches within `limit` as
        the photo has in one pair. Where parts of a scene look alike, right poses are contradicted by many matches, but
        every photo has neighbours that it fits; a photo with another's pose has none."""
        ends = np.concatenate([self.pairs[:, 0], self.pairs[:, 1]])
        count = int(ends.max(initial=-1)) + 1
        most, fitting = np.zeros(count, np.int64), np.zeros(count, np.int64)
        for result, rows in ((most, self.pair_of), (fitting, self.pair_of[errors.error <= limit])):
            np.maximum.at(result, ends, np.tile(np.bincount(rows, minlength=len(self.pairs)), 2))
        return float((2 * fitting < most)[most > 0].mean()) if most.any() else 0.0

    def pair_medians(self, errors: Errors) -> np.ndarray:
        """[E] the median error of each pair's matches, of the longer side."""
        order = np.lexsort((errors.error, self.pair_of))
        count = np.bincount(self.pair_of, minlength=len(self.pairs))
        return errors.error[order][np.cumsum(count) - count + count // 2]

    def sightings(self, poses: Reconstruction) -> Sightings:
        """The features that matches give a depth."""
        inverse = _TwoViews.of(poses, self).inverse_depths(self)
        first = np.unique(self.feature.ravel(), return_index=True)[1]  # an end of a match for every feature
        known = first[np.isfinite(inverse)]
        match, side = np.divmod(known, 2)
        return Sightings(self.images[match, side], self.rays[match, side], 1.0 / inverse[np.isfinite(inverse)])


@dataclass(frozen=True)
class _TwoViews:
    """What the poses of a pair make of each of its matches."""

    rotation: np.ndarray  # [M, 3, 3] cam_j_from_cam_i
    shift: np.ndarray  # [M, 3] likewise
    turned: np.ndarray  # [M] how far the match is from one at infinity, of the longer side
    met: np.ndarray  # [M] by how much the rays miss each other, likewise; inf if they meet behind a camera
    depth_i: np.ndarray  # [M] along the ray of the first photo
    depth_j: np.ndarray  # [M]

    @staticmethod
    def of(poses: Reconstruction, matched: MatchedRays) -> "_TwoViews":
        i, j = matched.images.T
        rotation = np.einsum("mab,mcb->mac", poses.rotations[j], poses.rotations[i])
        shift = poses.translations[j] - np.einsum("mab,mb->ma", rotation, poses.translations[i])
        a, b = np.einsum("mab,mb->ma", rotation, matched.rays[:, 0]), matched.rays[:, 1]
        scale = matched._sides_per_rad
        depth_i, depth_j = _depths(a, b, shift)
        met = np.where((depth_i > 0) & (depth_j > 0), _sampson(a, b, shift) * scale, np.inf)
        return _TwoViews(rotation, shift, _angle(a, b) * scale, met, depth_i, depth_j)

    def inverse_depths(self, matched: MatchedRays) -> np.ndarray:
        """[F] of every feature along its ray, the median over its matches by parallax; NaN where none has enough."""
        known = (self.turned > FAR) & (self.met <= FAR)
        features = np.concatenate([matched.feature[known, 0], matched.feature[known, 1]])
        inverse = 1.0 / np.concatenate([self.depth_i[known], self.depth_j[known]])
        count = int(matched.feature.max(initial=-1)) + 1
        return _weighted_medians(features, inverse, np.tile(self.turned[known], 2), count)


def _unit_rays(model: Reconstruction, images: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """[M, 3] in the camera frame."""
    result = np.ones((len(images), 3))
    camera_ids = model.camera_ids[images]
    for camera_id in np.unique(camera_ids):
        rows = np.flatnonzero(camera_ids == camera_id)
        result[rows, :2] = image_rays(model.cameras[int(camera_id)], xy[rows])
    return _unit(result)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[M] rad between unit vectors [M, 3]; exact for small ones too."""
    return 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(a - b, axis=1), 0.0, 1.0))


def _sampson(a: np.ndarray, b: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """[M] rad by which two rays, both in the second camera's frame, miss each other at best. Near the epipole and
    without a baseline this is 0: such matches are judged by the turn."""
    normal_b, normal_a = np.cross(shift, a), np.cross(shift, b)  # E a, and E^T b up to sign
    size = np.sqrt((normal_a**2).sum(1) + (normal_b**2).sum(1))
    return np.abs((normal_b * b).sum(1)) / np.maximum(size, 1e-300)


def _depths(a: np.ndarray, b: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """([M], [M]) distances along both rays to where they are closest: depth_i a + shift ~ depth_j b."""
    cosine = (a * b).sum(1)
    sine2 = np.maximum((np.cross(a, b) ** 2).sum(1), 1e-18)
    along_a, along_b = (a * shift).sum(1), (b * shift).sum(1)
    return (cosine * along_b - along_a) / sine2, (along_b - cosine * along_a) / sine2


def _weighted_medians(group: np.ndarray, values: np.ndarray, weights: np.ndarray, count: int) -> np.ndarray:
    """[count] the weighted median of each group's values; NaN for a group without any."""
    result = np.full(count, np.nan)
    order = np.lexsort((values, group))
    group, values, weights = group[order], values[order], weights[order]
    total = np.cumsum(weights)
    first = np.flatnonzero(np.diff(group, prepend=-1))
    before = (total - weights)[first]
    last = np.append(first[1:], len(group)) - 1
    middle = 0.5 * (before + total[last]) if len(group) else np.zeros(0)
    result[group[first]] = values[np.minimum(np.searchsorted(total, middle), last)]
    return result
