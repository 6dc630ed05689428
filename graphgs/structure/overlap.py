"""Do two cameras see the same? Judged by points one of them is likely to see that the other one would see too."""

from dataclasses import dataclass

import numpy as np

from graphgs.structure.coarse_views import CoarseViews
from graphgs.structure.uncertainty import PoseUncertainty

NEAR_MARGIN = 0.5  # a camera may see things at this share of its near distance
FAR_MARGIN = 1.2  # and at this multiple of its far distance; what lies further back is hidden or out of reach
FEWEST_IN_FRUSTUM = 3  # of 128 samples of a frustum that must lie in the other camera's: more than 2 %
FEWEST_OF_POINTS = 6  # of 64 points likely seen: more than 9 %, as they are surer than a frustum's volume
MARGIN_OF_POINTS = 0.9  # standard deviations that an image is widened by; 1 where only the frustum is known
_FLATTEST = np.deg2rad(89.0)  # half an image cannot be wider
_FIRST = 32  # samples that settle most pairs; the others are looked at where they do not
_CHUNK = 1024  # pairs judged at once: the arrays stay near the processor


def share_views(
    pairs: np.ndarray,  # [P, 2] int
    rotations: np.ndarray,  # [N, 3, 3] camera-from-world
    centers: np.ndarray,  # [N, 3]
    views: CoarseViews,
    uncertainty: PoseUncertainty,
) -> np.ndarray:
    """[P] bool: enough of what one camera of the pair is likely to see falls into the other one's image, in front of
    what that one sees there; either way round.

    The image is widened by about one standard deviation of the direction from one camera into the other, both rotations
    and both positions added in quadrature, so a sure pose gets a narrow margin and a near point a wide one."""
    by_points, by_frustum = (
        _Cameras(rotations, centers, views, _relative(uncertainty, deviations))
        for deviations in (MARGIN_OF_POINTS, 1.0)
    )
    keep = np.zeros(len(pairs), bool)
    for way in (pairs, pairs[:, ::-1]):
        todo = np.flatnonzero(~keep)
        todo = todo[by_frustum.near_enough(*way[todo].T)]
        known = views.has_points(way[todo, 0])
        for cameras, group, fewest in (
            (by_points, todo[known], FEWEST_OF_POINTS),
            (by_frustum, todo[~known], FEWEST_IN_FRUSTUM),
        ):
            for start in range(0, len(group), _CHUNK):
                part = group[start : start + _CHUNK]
                keep[part] = cameras.see_enough(*way[part].T, fewest)
    return keep


def _relative(uncertainty: PoseUncertainty, deviations: float) -> PoseUncertainty:
    """Of one camera as seen from another, so many standard deviations."""
    factor = deviations * np.sqrt(2.0)
    return PoseUncertainty(factor * uncertainty.rotation, factor * uncertainty.position)


@dataclass(frozen=True)
class _Cameras:
    rotations: np.ndarray
    centers: np.ndarray
    views: CoarseViews
    relative: PoseUncertainty  # of one camera as seen from another

    def near_enough(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """[C] bool: false where all that camera i sees lies behind camera j, or too far ahead of it: a quick look."""
        reach = self.views.reach[i]
        ahead = np.einsum("pa,pa->p", self.rotations[j, 2], self.centers[i] - self.centers[j])
        far = self.views.farthest[j] * FAR_MARGIN + self.relative.position
        return (ahead + reach > 0) & (ahead - reach <= far)

    def see_enough(self, i: np.ndarray, j: np.ndarray, fewest: int) -> np.ndarray:
        """[C] bool: camera j sees at least `fewest` of the samples of camera i."""
        turn = self.rotations[j] @ self.rotations[i].transpose(0, 2, 1)
        move = np.einsum("pab,pb->pa", self.rotations[j], self.centers[i] - self.centers[j])[..., None]
        todo = np.flatnonzero(self._may_see(turn @ self.views.corners(i) + move, i, j))
        count = np.zeros(len(i), np.int64)
        for block in (slice(0, _FIRST), slice(_FIRST, None)):
            samples = self.views.samples(i[todo], block)
            count[todo] += self._sees(turn[todo] @ samples + move[todo], j[todo]).sum(1)
            todo = todo[count[todo] < fewest]
        return count >= fewest

    def _sees(
        self,
        points: np.ndarray,  # [C, 3, S] in the frame of
        j: np.ndarray,  # [C]
    ) -> np.ndarray:
        """[C, S] bool."""
        views, relative = self.views, self.relative
        x, y, z = points.transpose(1, 0, 2)
        near = views.depth_range[j, :1] * NEAR_MARGIN - relative.position
        inside = z >= np.maximum(near, np.finfo(float).tiny)
        distance = np.sqrt((points * points).sum(1)) if relative.position > 0 else None
        slope = _widened(views.slope[j].T[..., None], relative, distance)
        inside &= (np.abs(x) <= slope[0] * z) & (np.abs(y) <= slope[1] * z)
        inside &= z <= views.far_limits(j, points) * FAR_MARGIN + relative.position
        return inside

    def _may_see(
        self,
        corners: np.ndarray,  # [C, 3, 8] of the frustum of camera i, in the frame of camera j
        i: np.ndarray,
        j: np.ndarray,
    ) -> np.ndarray:
        """[C] bool: false where a side of what j sees has the whole frustum beyond it, as for most far pairs."""
        views, relative = self.views, self.relative
        x, y, z = corners.transpose(1, 0, 2)
        nearest = np.linalg.norm(self.centers[i] - self.centers[j], axis=1) - views.reach[i]
        slope = _widened(views.slope[j].T, relative, np.maximum(nearest, 0.0))[..., None]
        far = views.farthest[j, None] * FAR_MARGIN + relative.position
        beyond = (z <= 0).all(1) | (z > far).all(1)
        for side, limit in ((x, slope[0] * z), (y, slope[1] * z)):
            beyond |= (side > limit).all(1) | (side < -limit).all(1)
        return ~beyond


def _widened(
    slope: np.ndarray,
    relative: PoseUncertainty,
    distance: np.ndarray | None,  # of the points looked at; not needed where positions are sure
) -> np.ndarray:
    """Tangent of the half angle with the standard deviation of the direction to a point at that distance added."""
    if relative.position == 0:
        margin = np.float64(relative.rotation)
    else:
        with np.errstate(divide="ignore"):  # a point in the camera's own place can lie anywhere
            margin = np.hypot(relative.rotation, relative.position / distance)
    tangent = np.tan(np.minimum(margin, _FLATTEST))
    turned = 1.0 - slope * tangent  # tan(a + b) = (tan a + tan b) / (1 - tan a tan b), below 90 degrees
    flattest = np.tan(_FLATTEST)
    return np.minimum((slope + tangent) / np.maximum(turned, 1.0 / flattest), flattest)
