"""What a photo's EXIF says: orientation, camera, focal length, position, time. Broken EXIF counts as none."""

import math
from dataclasses import dataclass
from datetime import UTC, datetime

from PIL import ExifTags, Image

FULL_FRAME_DIAGONAL_MM = math.hypot(36, 24)  # "35 mm equivalent" compares diagonals (CIPA DCG-001)
UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}  # FocalPlaneResolutionUnit: inch, cm, mm, um
PLAUSIBLE_FOCAL = (0.2, 20.0)  # in long sides; outside of it the tag is wrong


@dataclass(frozen=True)
class Exif:
    """EXIF facts of one file. Sizes are the stored ones, before rotation."""

    orientation: int = 1
    camera: str = ""  # make, model, lens, focal length and zoom as one string: equal for shots with equal intrinsics
    focal_in_diagonals: float | None = None  # focal length / image diagonal
    gps: tuple[float, float, float] | None = None  # latitude, longitude [deg], altitude [m]
    time: float | None = None  # [s] camera clock, read as UTC
    readable: bool = True  # False: there are tags, but nothing can be made of them

    def focal_px(self, width: int, height: int) -> float | None:
        """[px] focal length for an image of this size."""
        return None if self.focal_in_diagonals is None else self.focal_in_diagonals * math.hypot(width, height)


def read_exif(image: Image.Image) -> Exif:
    """EXIF of an opened image; must be called before its pixels are loaded (Pillow turns TIFFs while loading)."""
    try:
        root = image.getexif()
        detail, gps = root.get_ifd(ExifTags.IFD.Exif), root.get_ifd(ExifTags.IFD.GPSInfo)
    except Exception:  # foreign bytes in a format with many corners: Pillow raises whatever it stumbles over
        return Exif(readable=False)  # the sources stage names the photo
    base = ExifTags.Base
    orientation = root.get(base.Orientation, 1)
    focal, film = _number(detail.get(base.FocalLength)), _number(detail.get(base.FocalLengthIn35mmFilm))
    described = [root.get(base.Make), root.get(base.Model), detail.get(base.LensModel), focal, film]
    return Exif(
        orientation=orientation if orientation in range(1, 9) else 1,
        camera=" ".join(_plain(value) for value in described if value),
        focal_in_diagonals=_focal(image.size, detail, focal, film),
        gps=_position(gps),
        time=_time(detail.get(base.DateTimeOriginal) or root.get(base.DateTime), detail.get(base.SubsecTimeOriginal)),
    )


def _number(value) -> float | None:
    """A finite positive number, or None."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if math.isfinite(number) and number > 0 else None


def _plain(value) -> str:
    return "".join(c for c in str(value) if c.isprintable()).strip()


def _focal(size: tuple[int, int], detail: dict, focal: float | None, film: float | None) -> float | None:
    """Focal length in image diagonals: of the 35 mm equivalent, else of the sensor's pixel pitch."""
    diagonal, long_side = math.hypot(*size), max(size)
    base = ExifTags.Base
    pixels_per_unit = _number(detail.get(base.FocalPlaneXResolution))
    unit = UNIT_MM.get(detail.get(base.FocalPlaneResolutionUnit, 2))
    if film:
        found = film / FULL_FRAME_DIAGONAL_MM
    elif focal and pixels_per_unit and unit:
        # The pitch belongs to the image as the camera wrote it; the file may have been resized since.
        sides = (_number(detail.get(base.ExifImageWidth)), _number(detail.get(base.ExifImageHeight)))
        written = math.hypot(*sides) if all(sides) else diagonal
        found = focal / unit * pixels_per_unit / written
    else:
        return None
    return found if PLAUSIBLE_FOCAL[0] < found * diagonal / long_side < PLAUSIBLE_FOCAL[1] else None


def _position(gps: dict) -> tuple[float, float, float] | None:
    tags = ExifTags.GPS
    latitude = _degrees(gps.get(tags.GPSLatitude), gps.get(tags.GPSLatitudeRef), "S", 90)
    longitude = _degrees(gps.get(tags.GPSLongitude), gps.get(tags.GPSLongitudeRef), "W", 180)
    if latitude is None or longitude is None or (latitude == 0 and longitude == 0):
        return None  # 0, 0 is what receivers without a fix write
    altitude = _number(gps.get(tags.GPSAltitude)) or 0.0
    below_sea = gps.get(tags.GPSAltitudeRef) in (1, b"\x01")
    return latitude, longitude, -altitude if below_sea else altitude


def _degrees(value, reference, negative: str, limit: float) -> float | None:
    """Signed degrees of (degrees, minutes, seconds)."""
    try:
        degrees = sum(float(part) / 60**i for i, part in enumerate(value))
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    if not math.isfinite(degrees) or abs(degrees) > limit:
        return None
    return -degrees if _plain(reference).upper().startswith(negative) else degrees


def _time(text, fraction) -> float | None:
    try:
        moment = datetime.strptime(str(text).strip("\0 "), "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        return None
    digits = str(fraction).strip("\0 ") if fraction else ""
    return moment.timestamp() + (float(f"0.{digits}") if digits.isdecimal() else 0.0)
