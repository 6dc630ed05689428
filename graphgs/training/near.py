"""How near to a camera a scene begins, from the initial points in its view."""

import numpy as np

from graphgs.rendering.splats import NEAR
from graphgs.scene.views import Views

NEAR_QUANTILE = 0.01  # of the depths of the points in a view: single points in front of everything are often wrong
LEAST_POINTS = 20  # fewer say nothing about a view
CLOSEST_VIEWS = 0.05  # share of views that may begin nearer than the scene does


def near_depths(
    views: Views,
    positions: np.ndarray,  # [P, 3] initial points, world
) -> np.ndarray:
    """[N] camera z at which each training view begins, world units; NaN for held-out views, which decide nothing in
    training, and for views of too few points. Points hidden behind others count too: they are never the nearest."""
    depths = np.full(len(views.names), np.nan)
    for i in np.flatnonzero(~views.is_test):
        in_camera = positions @ views.viewmats[i, :3, :3].T + views.viewmats[i, :3, 3]
        in_front = in_camera[in_camera[:, 2] > 0.0]
        pixels = in_front @ views.Ks[i].T
        pixels = pixels[:, :2] / pixels[:, 2:]
        seen = in_front[((pixels >= 0.0) & (pixels < views.sizes[i])).all(axis=1), 2]
        if len(seen) >= LEAST_POINTS:
            depths[i] = np.quantile(seen, NEAR_QUANTILE)
    return depths


def scene_near(
    depths: np.ndarray,  # [N] of `near_depths`
    fraction: float,
) -> float:
    """Near plane of the whole scene, world units: `fraction` of the depth at which its closest views begin. What is
    nearer belongs to no surface; drawn, it covers a view as haze or a dark blot."""
    known = depths[np.isfinite(depths)]
    if not len(known) or fraction == 0.0:
        return NEAR
    return fraction * float(np.quantile(known, CLOSEST_VIEWS))
