"""The one image decoder of the project.

Rules, one per mode: 8-bit RGB as it is; grey repeated to RGB; palette, CMYK, YCbCr, LAB, HSV converted by Pillow;
1-bit to 0 and 255; 16-bit grey divided by 257 and rounded (colour at 16 bits keeps its high byte, Pillow's own rule);
floating point refused, since it has no declared range. Alpha becomes a mask: below one half a pixel is ignored.
EXIF orientation is applied, once. Colour profiles are not applied. Of several frames the first counts.
A file that ends early is refused: OpenCV and COLMAP would silently fill half a picture with grey.
"""

import contextlib
import struct
import warnings
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageFile

from graphgs.sources.exif import Exif, read_exif

MAX_PIXELS = 200_000_000  # the largest photo that is decoded
MAX_BYTES = 2**31  # the largest file that is read
MIN_SIDE = 32  # [px] below this nothing can be matched
# Pillow knows more formats, some of which start other programs: photos come in these, as far as this Pillow has them.
Image.init()
FORMATS = tuple(f for f in ("JPEG", "PNG", "TIFF", "WEBP", "BMP", "PPM", "GIF", "JPEG2000", "AVIF") if f in Image.OPEN)
WITH_ALPHA = ("LA", "La", "PA", "RGBA", "RGBa")
# Measured on photos: faster to write and to read, and smaller, than cv2's defaults and Pillow's level 1.
PNG_OPTIONS = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP]


class UnusableError(Exception):
    """This file cannot be used; the text says why, in words for the list of skipped photos."""


@dataclass(frozen=True)
class Header:
    """What a file says before its pixels are decoded."""

    width: int  # [px] upright, after EXIF rotation
    height: int
    exif: Exif


@dataclass(frozen=True)
class Decoded:
    """One decoded photo, upright, at most the asked long side."""

    pixels: np.ndarray  # [H, W, 3] uint8 RGB
    mask: np.ndarray | None  # [H, W] bool, False = ignore; None = no alpha
    header: Header


@contextlib.contextmanager
def decoding():
    """Pillow's settings while photos are decoded: our cap on pixels instead of its own, truncated files are errors,
    and no warnings about odd EXIF on the user's terminal. Put around any use of this module; not per thread."""
    before = Image.MAX_IMAGE_PIXELS, ImageFile.LOAD_TRUNCATED_IMAGES
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        Image.MAX_IMAGE_PIXELS, ImageFile.LOAD_TRUNCATED_IMAGES = None, False
        try:
            yield
        finally:
            Image.MAX_IMAGE_PIXELS, ImageFile.LOAD_TRUNCATED_IMAGES = before


def read_file(path: Path) -> bytes:
    """The file's bytes. Raises UnusableError if it cannot be read."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise UnusableError("the file is larger than 2 GB")
        data = path.read_bytes()
    except OSError as error:
        raise UnusableError(f"cannot be read: {error.strerror or error}") from None
    if not data:
        raise UnusableError("the file is empty")
    return data


def read_header(path: Path) -> Header:
    """Size and EXIF without decoding. Raises UnusableError as `decode` would for what the header shows."""
    try:
        with path.open("rb") as file:
            return _open(file)[1]
    except OSError as error:
        raise UnusableError(f"cannot be read: {error.strerror or error}") from None


def open_header(data: bytes) -> Header:
    """`read_header` of a file's bytes."""
    return _open(BytesIO(data))[1]


def decode(data: bytes, max_side: int) -> Decoded:
    """Decode, turn upright, and area-downsample to at most `max_side` px. Raises UnusableError with a reason."""
    image, header = _open(BytesIO(data))
    _shrink_jpeg(image, max_side)
    pixels, alpha, orientation = _load(image)
    width, height = decoded_size(header, max_side)
    pixels = _upright(_fit(pixels, width, height, orientation), orientation)
    if alpha is not None:
        alpha = _upright(_fit(alpha, width, height, orientation), orientation) >= 128
    return Decoded(pixels, alpha, header)


def decode_mask(data: bytes, header: Header, max_side: int) -> np.ndarray:
    """[H, W] bool at the decoded size of the photo with this header: 0 = ignore, any other value counts.

    The mask may have the upright or the stored size of the photo, or either's shape at another scale.
    """
    image, own = _open(BytesIO(data))
    pixels, alpha, orientation = _load(image)
    keep = pixels.any(axis=2)
    if alpha is not None:
        keep &= alpha >= 128
    keep = _upright(keep.astype(np.uint8) * 255, orientation)
    width, height = decoded_size(header, max_side)
    if same_shape((own.width, own.height), (header.width, header.height)):
        return _fit(keep, width, height, 1) >= 128
    if header.exif.orientation >= 5 and same_shape((own.height, own.width), (header.width, header.height)):
        return _upright(_fit(keep, width, height, header.exif.orientation), header.exif.orientation) >= 128
    raise UnusableError(f"its mask is {own.width}x{own.height} px, the photo {header.width}x{header.height}")


def encode_png(pixels: np.ndarray) -> bytes:
    """PNG of [H, W, 3] uint8 RGB, or of an [H, W] bool mask (0 and 255)."""
    if pixels.dtype == bool:
        pixels = pixels.astype(np.uint8) * 255
    else:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".png", pixels, PNG_OPTIONS)[1].tobytes()


def decoded_size(header: Header, max_side: int) -> tuple[int, int]:
    """[px] (width, height) of the decoded photo; never larger than the file."""
    scale = min(1.0, max_side / max(header.width, header.height))
    return max(1, round(header.width * scale)), max(1, round(header.height * scale))


def same_shape(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Two (width, height) are one shape at two scales, but for rounding to whole pixels."""
    return abs(a[0] * b[1] - a[1] * b[0]) <= max(*a, *b)


def _open(file) -> tuple[Image.Image, Header]:
    head = file.read(24)
    file.seek(0)
    if head[:8] == b"\x89PNG\r\n\x1a\n" and len(head) == 24:
        _check_size(*struct.unpack(">II", head[16:24]))  # before Pillow, which wants the pixel data to begin
    try:
        image = Image.open(file, formats=FORMATS)
    except Image.UnidentifiedImageError:
        raise UnusableError("not an image, whatever its name says, or its beginning is damaged") from None
    except MemoryError:
        raise
    except Exception as error:  # foreign bytes: a decoder may fail in any way
        raise UnusableError(f"cannot be opened as an image: {error}") from None
    exif = read_exif(image)
    width, height = image.size
    if image.format == "TIFF":
        width, height = image.tag_v2[256], image.tag_v2[257]  # `size` is the upright one in newer versions of Pillow
    if exif.orientation >= 5:
        width, height = height, width
    _check_size(width, height)
    return image, Header(width, height, exif)


def _check_size(width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise UnusableError(f"{width}x{height} px is over the limit of {MAX_PIXELS // 10**6} megapixels")
    if min(width, height) < MIN_SIDE:
        raise UnusableError(f"{width}x{height} px is too small (below {MIN_SIDE} px)")


def _shrink_jpeg(image: Image.Image, max_side: int) -> None:
    """Let libjpeg halve the picture while decoding (three times faster at 12 megapixels), as far as the halves come
    out even: an odd side would shift the rest by a fraction of a pixel."""
    if image.format not in ("JPEG", "MPO"):
        return
    width, height = image.size
    for factor in (8, 4, 2):
        if max(width, height) >= factor * max_side and width % factor == 0 and height % factor == 0:
            image.draft(image.mode, (width // factor, height // factor))
            return


def _load(image: Image.Image) -> tuple[np.ndarray, np.ndarray | None, int]:
    """(RGB [H, W, 3] uint8, alpha [H, W] uint8 or None, orientation these pixels still need)."""
    try:
        image.load()
        pixels, alpha = _to_rgb(image)
    except (UnusableError, MemoryError):
        raise
    except Exception as error:  # foreign bytes: a decoder may fail in any way
        raise UnusableError(f"damaged or cut short: {error}") from None
    return pixels, alpha, read_exif(image).orientation


def _to_rgb(image: Image.Image) -> tuple[np.ndarray, np.ndarray | None]:
    if image.mode == "F":
        raise UnusableError("floating-point pixels have no declared range; convert it to 8 or 16 bit")
    if image.mode.startswith("I"):  # 16-bit grey; mode I is how some files of 16 bit arrive
        grey = np.asarray(image)
        if grey.min() < 0 or grey.max() > 65535:
            raise UnusableError("32-bit pixels have no declared range; convert it to 8 or 16 bit")
        grey = ((grey.astype(np.uint32) + 128) // 257).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=2), None
    if image.mode in WITH_ALPHA or "transparency" in image.info:
        image = image.convert("LA") if image.mode == "La" else image
        rgba = np.asarray(image.convert("RGBA"))
        return rgba[..., :3], None if rgba[..., 3].min() == 255 else rgba[..., 3]
    return np.asarray(image if image.mode == "RGB" else image.convert("RGB")), None  # no copy: it may be 200 megapixels


def _fit(pixels: np.ndarray, width: int, height: int, orientation: int) -> np.ndarray:
    """Area-resample so that the upright picture has this size. Masks may grow, photos never do."""
    size = (height, width) if orientation >= 5 else (width, height)
    if (pixels.shape[1], pixels.shape[0]) == size:
        return pixels
    return cv2.resize(np.ascontiguousarray(pixels), size, interpolation=cv2.INTER_AREA)


def _upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Apply an EXIF orientation (1..8) to [H, W, ...] as stored."""
    if orientation >= 5:
        pixels = pixels.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return np.ascontiguousarray(pixels)
