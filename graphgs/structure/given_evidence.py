"""How well poses and points fit matches that were found without them.

A match says of two poses that its two rays meet in front of both cameras. How far they miss is measured as an angle
and told in pixels of the photo, lens distortion undone. Three things make that a test that wrong poses fail:

- rays that miss (the epipolar distance: Sampson's, of unit rays, so that it holds for fisheyes too);
- rays that meet behind a camera, which is all that tells forwards from backwards on a straight drive;
- the depth that the other photos give a feature: where each pair for itself would fit, as on a straight drive whose
  poses are permuted, the depths do not.

A match that the turn between the poses alone explains (the homography at infinity, within `STILL`) fits, whatever the
baseline: where there is little parallax, the rotation is what can be tested.
"""

from dataclasses import dataclass

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.evidence import VerifiedMatches
from graphgs.structure.undistort import image_rays

# Of the longer side. Features found at 640 px are right to a pixel, .16 %, and verification lets pass .25 to .4 %: what
# is 1 % off is neither. A pose that is off by as much (12 px of 1242) is of no use to training.
FAR = 0.005
STILL = FAR  # a match that moves less cannot be told from one at infinity


@dataclass(frozen=True)
class MatchErrors:
    """How far each match is from what the poses expect of it."""

    pairs: np.ndarray  # [E, 2] int
    pair_of: np.ndarray  # [M] int
    error: np.ndarray  # [M] of the longer side; inf where the rays meet behind a camera
    side_px: np.ndarray  # [M] longer side of the photo

    @property
    def contradicted(self) -> float:
        """Share of the matches that contradict the poses."""
        return float((self.error > FAR).mean()) if len(self.error) else 0.0

    @property
    def median(self) -> float:
        """Of the longer side."""
        return float(np.median(self.error)) if len(self.error) else 0.0

    @property
    def pair_median(self) -> np.ndarray:
        """[E] of the longer side."""
        order = np.lexsort((self.error, self.pair_of))
        count = np.bincount(self.pair_of, minlength=len(self.pairs))
        start = np.cumsum(count) - count
        return self.error[order][start + count // 2] if len(order) else np.zeros(0)


class MatchedRays:
    """The matches of a set of photos as unit rays: what does not depend on poses, only on intrinsics."""

    def __init__(self, model: Reconstruction, verified: VerifiedMatches):
        """Pairs of `verified` count the names of `model`."""
        self.pairs, self.pair_of = verified.pairs, verified.pair_of
        images = verified.pairs[self.pair_of]  # [M, 2]
        self.images = images
        self.xy = np.stack([verified.xy_i, verified.xy_j], axis=1)  # [M, 2, 2]
        self.rays = np.stack([_unit_rays(model, images[:, k], self.xy[:, k]) for k in range(2)], axis=1)  # [M, 2, 3]
        focal = np.array([np.mean(camera.focal_and_center[:2]) for camera in model.cameras])[model.camera_ids]
        side = np.array([max(camera.width, camera.height) for camera in model.cameras])[model.camera_ids]
        self.side_px = side[images].mean(1)
        self.sides_per_rad = (focal / side)[images].mean(1)
        ends = np.concatenate([images[:, :1], images[:, 1:]]), np.concatenate([self.xy[:, 0], self.xy[:, 1]])
        keys = np.column_stack([ends[0], np.rint(ends[1] * 64)]).astype(np.int64)
        self.feature = np.unique(keys, axis=0, return_inverse=True)[1].reshape(2, -1).T  # [M, 2] int

    def errors(self, model: Reconstruction) -> MatchErrors:
        """Of every match, with the poses of `model` (whose intrinsics are those the rays were made with)."""
        i, j = self.images.T
        rotation = np.einsum("mab,mcb->mac", model.rotations[j], model.rotations[i])  # j from i
        shift = model.translations[j] - np.einsum("mab,mb->ma", rotation, model.translations[i])
        a, b = np.einsum("mab,mb->ma", rotation, self.rays[:, 0]), self.rays[:, 1]
        turned = _angle(a, b) * self.sides_per_rad
        missed = _sampson(a, b, shift) * self.sides_per_rad
        depth_i, depth_j = _depths(a, b, shift)
        met = np.where((depth_i > 0) & (depth_j > 0), missed, np.inf)
        informative = (turned > STILL) & (met <= FAR)
        other = self._against_the_rest(rotation, shift, depth_i, depth_j, turned, informative)
        return MatchErrors(self.pairs, self.pair_of, np.maximum(np.minimum(turned, met), other), self.side_px)

    def _against_the_rest(self, rotation, shift, depth_i, depth_j, turned, informative) -> np.ndarray:
        """[M] how far a match is from where the depth that most of a feature's matches give it puts it, by the better
        of its two features; 0 where there is no such depth."""
        both = np.concatenate([self.feature[:, 0], self.feature[:, 1]])
        depths, weight = np.concatenate([depth_i, depth_j]), np.concatenate([turned, turned])
        use = np.concatenate([informative, informative])
        count = int(both.max(initial=-1)) + 1
        inverse = _weighted_medians(both[use], 1.0 / depths[use], weight[use], count)
        several = np.bincount(both, minlength=count) > 1
        result = np.full(len(turned), np.inf)
        for side in range(2):
            rho = np.where(several, inverse, np.nan)[self.feature[:, side]]
            if side == 0:
                seen = np.einsum("mab,mb->ma", rotation, self.rays[:, 0]) + rho[:, None] * shift
            else:
                seen = np.einsum("mba,mb->ma", rotation, self.rays[:, 1] - rho[:, None] * shift)
            away = _angle(seen / np.linalg.norm(seen, axis=1, keepdims=True), self.rays[:, 1 - side])
            result = np.fmin(result, away * self.sides_per_rad)
        return np.where(np.isinf(result), 0.0, result)


def _unit_rays(model: Reconstruction, images: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """[M, 3] in the camera frame."""
    result = np.ones((len(images), 3))
    camera_ids = model.camera_ids[images]
    for camera_id in np.unique(camera_ids):
        rows = np.flatnonzero(camera_ids == camera_id)
        result[rows, :2] = image_rays(model.cameras[int(camera_id)], xy[rows])
    return result / np.linalg.norm(result, axis=1, keepdims=True)


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
