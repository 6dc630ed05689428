"""The shape of a reconstruction against GPS: positions are metres off, but many of them tell a bowl from a plane.

A similarity onto the positions is taken out first. Then two shapes are looked for that a wrong lens gives: heights that
grow with the squared distance from the middle, and a stretch along one direction. Each comes with its standard
deviation, so a shape within the noise of the positions is none.
"""

from dataclasses import dataclass

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import align, align_robust
from graphgs.sources.photos import Photos
from graphgs.structure.gps import enu_from_wgs84

_FEWEST = 12
_CERTAIN = 4.0  # standard deviations: positions of one flight err together
_LEAST_BEND_M = 0.5
_LEAST_STRETCH = 0.02
_OUTLIER = 4.0  # robust standard deviations
_GAUSSIAN = 1.4826


@dataclass(frozen=True)
class GpsShape:
    """What is left of the difference between cameras and their GPS positions after a similarity."""

    photos: int  # that have a position and agree
    bend_m: float  # by which heights bend from the middle to the rim; positive: the rim is too high
    bend_deviation_m: float
    scatter_m: float  # of heights, once the bend is taken out
    stretch: float  # of one direction against the one across it
    stretch_deviation: float

    @property
    def bends(self) -> bool:
        return abs(self.bend_m) > max(_CERTAIN * self.bend_deviation_m, _LEAST_BEND_M)

    @property
    def stretches(self) -> bool:
        return self.stretch > max(_CERTAIN * self.stretch_deviation, _LEAST_STRETCH)

    def describe(self) -> tuple[str, ...]:
        """What GPS contradicts, for people."""
        said = []
        if self.bends:
            said.append(
                f"heights bend by {abs(self.bend_m):.1f} m (give or take {self.bend_deviation_m:.1f}) from the middle "
                f"to the rim, against the GPS positions of {self.photos} photos"
            )
        if self.stretches:
            said.append(
                f"the scene is stretched along one direction by {100 * self.stretch:.1f} %, against the GPS positions "
                f"of {self.photos} photos"
            )
        return tuple(said)


def gps_shape(model: Reconstruction, photos: Photos) -> GpsShape | None:
    """None where too few photos have a position, or all lie on one line, where a bend cannot be told from a tilt."""
    position = {photo.name: photo.gps for photo in photos.photos if photo.gps is not None}
    rows = np.array([k for k, name in enumerate(model.names) if name in position], np.int64)
    if len(rows) < _FEWEST:
        return None
    positions = np.array([position[model.names[k]] for k in rows])
    told = enu_from_wgs84(positions)
    if np.ptp(positions[:, 2]) == 0 or not _spread(told[:, :2]):  # no altitude was written, or a single track
        return None
    found = align_robust(model.centers[rows], told).apply(model.centers[rows])
    away = np.linalg.norm(found - told, axis=1)
    agrees = away <= _OUTLIER * max(_GAUSSIAN * float(np.median(away)), 1e-9)
    if agrees.sum() < _FEWEST:
        return None
    found, told = align(found[agrees], told[agrees]).apply(found[agrees]), told[agrees]
    rest, where = found - told, told[:, :2] - told[:, :2].mean(0)
    radius2 = (where**2).sum(1)
    height = _regression(np.column_stack([radius2, where, np.ones(len(where))]), rest[:, 2])
    strain, deviations = _strain(where, rest[:, :2])
    rim2 = float(np.percentile(radius2, 95))
    return GpsShape(
        photos=int(agrees.sum()),
        bend_m=float(height.values[0]) * rim2,
        bend_deviation_m=float(height.deviations[0]) * rim2,
        scatter_m=height.scatter,
        stretch=2.0 * float(np.hypot(*strain)),
        stretch_deviation=2.0 * float(max(deviations)),
    )


@dataclass(frozen=True)
class _Regression:
    values: np.ndarray
    deviations: np.ndarray
    scatter: float


def _regression(design: np.ndarray, target: np.ndarray) -> _Regression:
    values = np.linalg.lstsq(design, target, rcond=None)[0]
    rest = target - design @ values
    scatter = float(rest.std()) * np.sqrt(len(rest) / max(len(rest) - design.shape[1], 1))
    return _Regression(values, scatter * np.sqrt(np.diag(np.linalg.pinv(design.T @ design))), scatter)


def _strain(where: np.ndarray, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """((half the difference of stretches along east and north, shear), their deviations)."""
    (x, y), one, none = where.T, np.ones(len(where)), np.zeros(len(where))
    # Unknowns: the two of the strain, scale, turn, shifts.
    east = np.column_stack([x, y, x, -y, one, none])
    north = np.column_stack([-y, x, y, x, none, one])
    fit = _regression(np.concatenate([east, north]), np.concatenate([rest[:, 0], rest[:, 1]]))
    return fit.values[:2], fit.deviations[:2]


def _spread(plane: np.ndarray) -> bool:
    singular = np.linalg.svd(plane - plane.mean(0), compute_uv=False)
    return bool(singular[1] > 0.1 * singular[0])
