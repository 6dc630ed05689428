"""GPS positions from a file: CSV with a header that names its columns, or GeoJSON points.

CSV: a column for the photo's name (name, filename, file, image, photo), `lat` and `lon` in degrees (WGS84), and if
there is one `alt` in metres; also spelled latitude, longitude, lng, long, altitude, height, elevation, ele. Commas,
semicolons or tabs. GeoJSON: a FeatureCollection of Points, [lon, lat] or [lon, lat, alt], whose properties hold the
name under one of the same words.
"""

import csv
import json
import math
from pathlib import Path, PurePosixPath

import numpy as np

from graphgs.errors import DataError, UsageError
from graphgs.scene.names import inside
from graphgs.sources.given import match_names

MAX_BYTES = 200_000_000
_COLUMNS = {
    "name": ("name", "filename", "file_name", "file", "image", "image_name", "photo", "photo_name", "picture", "label"),
    "latitude": ("lat", "latitude", "gps_latitude", "gpslatitude"),
    "longitude": ("lon", "lng", "long", "longitude", "gps_longitude", "gpslongitude"),
    "altitude": ("alt", "altitude", "height", "elevation", "ele", "gps_altitude", "gpsaltitude", "z"),
}
HINT = "expected is CSV with columns name, lat, lon and maybe alt, or GeoJSON points with a property name"


def read_positions(file: Path, photos: tuple[str, ...]) -> dict[str, tuple[float, float, float]]:
    """Latitude, longitude [deg] and altitude [m] by photo name, for the photos the file knows.

    Names match as those of poses do, else without their ending. Positions without altitude get the median of the
    others, or 0. Raises UsageError for a missing file, DataError for one that cannot be read or names no photo."""
    if not file.is_file():
        raise UsageError(f"{file}: does not exist", hint="--prior gps=FILE takes a CSV or GeoJSON file")
    try:
        if file.stat().st_size > MAX_BYTES:
            raise ValueError("larger than 200 MB")
        text = file.read_text(encoding="utf-8-sig")
        rows = _geojson(text) if text.lstrip()[:1] == "{" else _csv(text)
    except (OSError, ValueError, RecursionError, csv.Error) as error:
        raise DataError(f"{file}: no list of positions: {error}", hint=HINT) from None
    given = {name: position for name, position in rows if name is not None}
    owner = match_names(tuple(given), photos)
    found = {photo: list(given.values())[i] for photo, i in owner.items()}
    if not found:  # sheets are often kept without the files' endings
        bare = {str(PurePosixPath(name).with_suffix("")): position for name, position in given.items()}
        by_stem = match_names(tuple(bare), tuple(str(PurePosixPath(name).with_suffix("")) for name in photos))
        found = {
            photo: list(bare.values())[by_stem[stem]]
            for photo in photos
            if (stem := str(PurePosixPath(photo).with_suffix(""))) in by_stem
        }
    if not found:
        raise DataError(f"{file}: none of its {len(given)} positions names a photo", hint=HINT)
    heights = [position[2] for position in found.values() if position[2] is not None]
    level = float(np.median(heights)) if heights else 0.0
    return {name: (lat, lon, level if alt is None else alt) for name, (lat, lon, alt) in found.items()}


def _csv(text: str) -> list[tuple[str | None, tuple]]:
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines:
        raise ValueError("it is empty")
    delimiter = max(",;\t", key=lines[0].count)
    table = list(csv.reader(lines, delimiter=delimiter, skipinitialspace=True))
    header = [column.strip().lower().replace(" ", "_") for column in table[0]]
    at = {what: next((header.index(w) for w in words if w in header), None) for what, words in _COLUMNS.items()}
    for what in ("name", "latitude", "longitude"):
        if at[what] is None:
            raise ValueError(f"no column for the {what} in its first line ({', '.join(header)[:200]})")
    rows = []
    for number, row in enumerate(table[1:], 2):
        cells = {what: row[k].strip() if k is not None and k < len(row) else "" for what, k in at.items()}
        where = f"row {number}"
        rows.append((inside(cells["name"]), _position(cells["latitude"], cells["longitude"], cells["altitude"], where)))
    return rows


def _geojson(text: str) -> list[tuple[str | None, tuple]]:
    data = json.loads(text)
    rows = []
    for number, feature in enumerate(data.get("features") or ()):
        geometry = feature.get("geometry") if isinstance(feature, dict) else None
        if not isinstance(geometry, dict) or geometry.get("type") != "Point":
            continue  # tracks and areas may be drawn beside the photos
        properties = {str(k).lower(): v for k, v in (feature.get("properties") or {}).items()}
        name = next((properties[word] for word in _COLUMNS["name"] if properties.get(word)), None)
        place = geometry.get("coordinates")
        if not isinstance(place, list) or len(place) < 2:
            raise ValueError(f"feature {number} has no coordinates")
        altitude = place[2] if len(place) > 2 else ""
        rows.append((inside(str(name)) if name else None, _position(place[1], place[0], altitude, f"feature {number}")))
    if not rows:
        raise ValueError("it holds no points")
    return rows


def _position(latitude, longitude, altitude, where: str) -> tuple[float, float, float | None]:
    try:
        place = float(latitude), float(longitude), None if altitude in ("", None) else float(altitude)
    except (TypeError, ValueError):
        raise ValueError(f"{where}: '{latitude}', '{longitude}', '{altitude}' are no numbers") from None
    if not (abs(place[0]) <= 90 and abs(place[1]) <= 360) or not math.isfinite(place[2] or 0.0):
        raise ValueError(f"{where}: {latitude}, {longitude} is no place on Earth")
    return place
