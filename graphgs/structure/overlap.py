"""Do two cameras see the same? Judged by points one of them is likely to see that the other one would see too."""

import numpy as np

from graphgs.structure.coarse_views import CoarseViews
from graphgs.structure.uncertainty import PoseUncertainty

NEAR_MARGIN = 0.5  # a camera may see things at this share of its near distance
FAR_MARGIN = 1.2  # and at this multiple of its far distance; what lies further back is hidden or out of reach
LEAST_SHARE = 0.02  # more than this share of a frustum must lie in the other camera's
LEAST_SHARE_OF_POINTS = 0.09  # and of the points likely seen, which are surer than a frustum's volume
_FLATTEST = np.deg2rad(89.0)  # half an image cannot be wider
_CHUNK = 256  # pairs judged at once: the arrays stay in the processor's cache


def share_views(
    pairs: np.ndarray,  # [P, 2] int
    rotations: np.ndarray,  # [N, 3, 3] camera-from-world
    centers: np.ndarray,  # [N, 3]
    views: CoarseViews,
    uncertainty: PoseUncertainty,
) -> np.ndarray:
    """[P] bool: enough of what one camera of the pair is likely to see falls into the other one's image, in front of
    what that one sees there; either way round.

    The image is widened by one standard deviation of the direction from one camera into the other, both rotations and
    both positions added in quadrature, so a sure pose gets a narrow margin and a near point a wide one."""
    relative = PoseUncertainty(np.sqrt(2.0) * uncertainty.rotation, np.sqrt(2.0) * uncertainty.position)
    reach = _reach(views)
    keep = np.zeros(len(pairs), bool)
    for way in (pairs, pairs[:, ::-1]):
        todo = np.flatnonzero(~keep)
        todo = todo[_within_reach(way[todo], rotations, centers, views, reach, relative)]
        with_points = views.has_points[way[todo, 0]]
        for group, least in ((todo[with_points], LEAST_SHARE_OF_POINTS), (todo[~with_points], LEAST_SHARE)):
            for start in range(0, len(group), _CHUNK):
                part = group[start : start + _CHUNK]
                keep[part] = _share(*way[part].T, rotations, centers, views, relative) > least
    return keep


def _share(
    i: np.ndarray, j: np.ndarray, rotations: np.ndarray, centers: np.ndarray, views: CoarseViews, relative
) -> np.ndarray:
    """[C] share of the samples of camera i that camera j sees."""
    turn = rotations[j] @ rotations[i].transpose(0, 2, 1)
    move = np.einsum("pab,pb->pa", rotations[j], centers[i] - centers[j])
    local = turn @ views.samples(i) + move[..., None]
    z = local[:, 2]
    ahead = z > 0
    tangents = (local[:, :2] / np.where(ahead, z, np.inf)[:, None]).transpose(1, 0, 2)  # [2, C, S]
    slope = views.slope[j].T[..., None]
    distance = np.sqrt((local * local).sum(1)) if relative.position > 0 else None
    inside = ahead & (np.abs(tangents) <= _widened(slope, relative, distance)).all(0)
    inside &= z >= views.depth_range[j, :1] * NEAR_MARGIN - relative.position
    inside &= z <= views.far_limits(j, tangents) * FAR_MARGIN + relative.position
    return inside.mean(1)


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


def _reach(views: CoarseViews) -> np.ndarray:
    """[N] distance to the farthest sample, or somewhat more."""
    reach = views.depth_range[:, 1] * np.sqrt(1.0 + (views.slope**2).sum(1))
    if views.has_points.any():
        reach[views.has_points] = np.linalg.norm(views.seen, axis=2).max(1)
    return reach


def _within_reach(
    pairs: np.ndarray, rotations: np.ndarray, centers: np.ndarray, views: CoarseViews, reach: np.ndarray, relative
) -> np.ndarray:
    """[P] bool: false where no sample of i can lie in j's image and depths, by the ball that holds all of them: most
    far pairs go here, at a hundredth of the cost."""
    i, j = pairs.T
    far = views.depth_range[:, 1].copy()
    if views.has_points.any():
        far[views.has_points] = views.far.max(1)
    far = far * FAR_MARGIN + relative.position
    offset = centers[i] - centers[j]
    ahead = np.einsum("pa,pa->p", rotations[j, 2], offset)
    within = (ahead - reach[i] <= far[j]) & (ahead + reach[i] > 0)
    nearest = np.linalg.norm(offset, axis=1) - reach[i]  # of a sample from camera j
    slope = _widened(views.slope[j], relative, np.maximum(nearest, 0.0)[:, None])
    return within & (nearest <= far[j] * np.sqrt(1.0 + (slope**2).sum(1)))
