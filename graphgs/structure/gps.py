"""GPS positions as metres around their middle."""

import numpy as np
from scipy.spatial import cKDTree

from graphgs.sources.photos import Photos

_EQUATOR_M = 6378137.0  # WGS84 semi-major axis
_FLATTENING = 1.0 / 298.257223563
_ECCENTRICITY2 = _FLATTENING * (2.0 - _FLATTENING)


def median_position(
    positions: np.ndarray,  # [N, 3] latitude and longitude [deg], altitude [m]
) -> np.ndarray:
    """[3] the middle, coordinate by coordinate. Longitudes around +-180 degrees lie side by side."""
    turned = positions.copy()
    turned[:, 1] = (positions[:, 1] - positions[0, 1] + 180.0) % 360.0 - 180.0 + positions[0, 1]
    return np.median(turned, axis=0)


def enu_from_wgs84(
    positions: np.ndarray,  # [N, 3] latitude and longitude [deg], altitude above the ellipsoid [m]
) -> np.ndarray:
    """[N, 3] east, north, up [m], with the origin at the median position."""
    origin = median_position(positions)
    offset = _ecef(positions) - _ecef(origin[None])
    latitude, longitude = np.radians(origin[:2])
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    enu_from_ecef = np.array(
        [
            [-sin_lon, cos_lon, 0.0],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ]
    )
    return offset @ enu_from_ecef.T


def _ecef(positions: np.ndarray) -> np.ndarray:
    """[N, 3] m, earth-centred and earth-fixed."""
    latitude, longitude = np.radians(positions[:, 0]), np.radians(positions[:, 1])
    altitude = positions[:, 2]
    normal = _EQUATOR_M / np.sqrt(1.0 - _ECCENTRICITY2 * np.sin(latitude) ** 2)
    return np.stack(
        [
            (normal + altitude) * np.cos(latitude) * np.cos(longitude),
            (normal + altitude) * np.cos(latitude) * np.sin(longitude),
            (normal * (1.0 - _ECCENTRICITY2) + altitude) * np.sin(latitude),
        ],
        axis=1,
    )


def nearest_by_gps(photos: Photos, count: int) -> np.ndarray:
    """[N, count] the photos that EXIF says were taken nearest to each, the nearest first; -1 where it does not say."""
    result = np.full((len(photos.photos), count), -1, np.int64)
    known = np.array([k for k, photo in enumerate(photos.photos) if photo.gps is not None], np.int64)
    if len(known) < 2:
        return result
    plane = enu_from_wgs84(np.array([photos.photos[k].gps for k in known]))[:, :2]
    found = cKDTree(plane).query(plane, min(count + 1, len(known)))[1]
    for k, row in zip(known, found, strict=True):
        others = known[row[known[row] != k]][:count]
        result[k, : len(others)] = others
    return result
