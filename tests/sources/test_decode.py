"""The decoder's rules, one test per rule."""

import struct
import warnings
import zlib
from io import BytesIO

import cv2
import numpy as np
import pytest
from PIL import Image, ImageFile

from graphgs.sources.decode import (
    UnusableError,
    decode,
    decode_mask,
    decoded_size,
    decoding,
    encode_png,
    open_header,
    read_header,
    same_shape,
)
from tests.support.pictures import picture

ORIENTATION = 0x0112


@pytest.fixture(autouse=True)
def _decoding():
    with decoding():
        yield


def saved(image, fmt: str = "PNG", **options) -> bytes:
    image = image if isinstance(image, Image.Image) else Image.fromarray(image)
    out = BytesIO()
    image.save(out, fmt, **options)
    return out.getvalue()


def png_header(width: int, height: int) -> bytes:
    body = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + body + struct.pack(">I", zlib.crc32(body))


def upright_by_definition(stored: np.ndarray, orientation: int) -> np.ndarray:
    """EXIF: where the stored row 0 and column 0 lie in the upright picture."""
    return {
        1: lambda a: a,
        2: np.fliplr,
        3: lambda a: np.rot90(a, 2),
        4: np.flipud,
        5: lambda a: a.swapaxes(0, 1),
        6: lambda a: np.rot90(a, -1),
        7: lambda a: np.rot90(a, 2).swapaxes(0, 1),
        8: lambda a: np.rot90(a, 1),
    }[orientation](stored)


@pytest.mark.parametrize("fmt", ["PNG", "TIFF"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_applied_once(orientation, fmt):
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    data = saved(picture(), fmt, exif=exif)
    decoded = decode(data, 1600)
    np.testing.assert_array_equal(decoded.pixels, upright_by_definition(picture(), orientation))
    header = open_header(data)
    assert (header.height, header.width) == decoded.pixels.shape[:2]
    assert header.exif.orientation == orientation
    small = decode(data, 24)  # the same after downsampling
    assert max(small.pixels.shape) == 24
    expected = cv2.resize(decoded.pixels, small.pixels.shape[1::-1], interpolation=cv2.INTER_AREA)
    assert np.abs(small.pixels.astype(int) - expected).max() <= 1


def test_jpeg_orientation_agrees_with_opencv():
    exif = Image.Exif()
    exif[ORIENTATION] = 6
    data = saved(picture(), "JPEG", exif=exif, quality=95)
    theirs = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    ours = decode(data, 1600).pixels
    assert ours.shape == theirs.shape == (48, 40, 3)
    assert np.abs(ours.astype(int) - theirs).mean() < 2  # chroma upsampling may differ


def test_grey_and_one_bit():
    grey = picture()[..., 0]
    np.testing.assert_array_equal(decode(saved(grey), 1600).pixels, np.repeat(grey[..., None], 3, 2))
    bits = Image.fromarray(grey > 128)
    assert bits.mode == "1"
    np.testing.assert_array_equal(decode(saved(bits), 1600).pixels[..., 0], np.where(grey > 128, 255, 0))


@pytest.mark.parametrize("fmt", ["PNG", "TIFF", "PPM"])
def test_16_bit_grey_is_divided_by_257(fmt):
    grey = np.arange(48 * 40, dtype=np.uint16).reshape(40, 48) * 34
    grey[0, :3] = (0, 65535, 257)
    pixels = decode(saved(grey, fmt), 1600).pixels
    np.testing.assert_array_equal(pixels[..., 1], np.round(grey / 257).astype(np.uint8))
    assert pixels[0, :3, 0].tolist() == [0, 255, 1]


def test_16_bit_colour_keeps_its_high_byte():
    colour = np.full((40, 48, 3), 0x12FF, np.uint16)
    data = cv2.imencode(".png", colour)[1].tobytes()
    assert (decode(data, 1600).pixels == 0x12).all()


def test_floating_point_and_32_bit_are_refused():
    with pytest.raises(UnusableError, match="floating-point"):
        decode(saved(picture()[..., 0].astype(np.float32), "TIFF"), 1600)
    with pytest.raises(UnusableError, match="32-bit"):
        decode(saved(np.full((40, 48), 70000, np.int32), "TIFF"), 1600)


def test_palette_and_cmyk():
    palette = Image.fromarray(picture()).quantize(64)
    np.testing.assert_array_equal(decode(saved(palette), 1600).pixels, np.asarray(palette.convert("RGB")))
    cmyk = Image.fromarray(picture()).convert("CMYK")
    decoded = decode(saved(cmyk, "TIFF"), 1600)
    assert np.abs(decoded.pixels.astype(int) - picture()).max() <= 1
    assert decoded.mask is None
    printed = decode(saved(cmyk, "JPEG", quality=95), 1600).pixels  # as Adobe writes them, inverted
    assert np.abs(printed.astype(int) - picture()).mean() < 6


def test_alpha_becomes_a_mask():
    rgba = np.dstack([picture(), np.full((40, 48), 255, np.uint8)])
    assert decode(saved(rgba), 1600).mask is None  # opaque
    rgba[:10, :, 3], rgba[10:20, :, 3], rgba[20:30, :, 3] = 0, 127, 128
    decoded = decode(saved(rgba), 1600)
    np.testing.assert_array_equal(decoded.mask, np.repeat([False, False, True, True], 10)[:, None].repeat(48, 1))
    np.testing.assert_array_equal(decoded.pixels, picture())
    grey_alpha = decode(saved(Image.fromarray(rgba).convert("LA")), 1600)
    np.testing.assert_array_equal(grey_alpha.mask, decoded.mask)
    assert decode(saved(rgba), 24).mask.shape == (20, 24)


def test_transparent_palette_colour_is_ignored():
    indexed = Image.fromarray((picture()[..., 0] > 128).astype(np.uint8), "P")
    indexed.putpalette([10, 20, 30, 200, 210, 220])
    decoded = decode(saved(indexed, "PNG", transparency=0), 1600)
    np.testing.assert_array_equal(decoded.mask, picture()[..., 0] > 128)


def test_of_several_frames_the_first_counts():
    frames = [Image.fromarray(picture(i)) for i in range(3)]
    for fmt in ("PNG", "TIFF"):
        data = saved(frames[0], fmt, save_all=True, append_images=frames[1:])
        np.testing.assert_array_equal(decode(data, 1600).pixels, picture(0))
    assert decode(saved(frames[0], "GIF", save_all=True, append_images=frames[1:]), 1600).pixels.shape == (40, 48, 3)


@pytest.mark.parametrize("fmt", ["JPEG", "PNG", "WEBP", "TIFF", "GIF", "BMP"])
def test_half_a_file_is_refused(fmt):
    whole = saved(np.random.default_rng(0).integers(0, 256, (200, 200, 3), dtype=np.uint8), fmt)
    decode(whole, 1600)
    before = ImageFile.LOAD_TRUNCATED_IMAGES
    with pytest.raises(UnusableError):
        decode(whole[: len(whole) // 2], 1600)
    assert ImageFile.LOAD_TRUNCATED_IMAGES is before is False


def test_foreign_content_is_refused_whatever_its_name(tmp_path):
    for content in (b"these are words", b"%!PS-Adobe-3.0 EPSF-3.0\n", b"\xff\xd8\xff", bytes(1000), b"RIFF0000WEBP"):
        with pytest.raises(UnusableError):
            decode(content, 1600)
        (tmp_path / "a.jpg").write_bytes(content)
        with pytest.raises(UnusableError):
            read_header(tmp_path / "a.jpg")


def test_200_megapixels_are_the_limit_seen_in_the_header():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(UnusableError, match="60000x60000 px is over the limit of 200 megapixels"):
            decode(png_header(60000, 60000), 1600)
    bomb = bytearray(saved(picture(), "BMP"))
    bomb[18:26] = struct.pack("<ii", 60000, 60000)
    with pytest.raises(UnusableError, match="200 megapixels"):
        decode(bytes(bomb), 1600)


def test_pillow_s_own_cap_neither_warns_nor_raises_and_is_put_back():
    limit = Image.MAX_IMAGE_PIXELS
    assert limit is None
    data = saved(Image.new("L", (12000, 8000)))  # 96 megapixels: Pillow warns from 89
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        header = open_header(data)
    assert (header.width, header.height) == (12000, 8000)


def test_settings_of_pillow_are_restored():
    Image.MAX_IMAGE_PIXELS = 1234
    with decoding():
        assert Image.MAX_IMAGE_PIXELS is None
    assert Image.MAX_IMAGE_PIXELS == 1234


def test_tiny_pictures_are_refused():
    with pytest.raises(UnusableError, match="31x40 px is too small"):
        decode(saved(picture(width=31)), 1600)


def test_downsampling_is_by_area_and_never_up():
    checks = np.kron(np.indices((40, 48)).sum(0) % 2 * 255, np.ones((1, 1)))[..., None].repeat(3, 2).astype(np.uint8)
    small = decode(saved(checks), 24).pixels
    assert small.shape == (20, 24, 3)
    assert np.abs(small.astype(int) - 127.5).max() < 1  # every pixel is the mean of two black and two white ones
    assert decode(saved(checks), 1600).pixels.shape == (40, 48, 3)


def test_a_jpeg_halved_while_decoding_is_the_same_picture():
    big = picture(width=640, height=480)
    data = saved(big, "JPEG", quality=95)
    whole = decode(data, 1600).pixels
    for side in (320, 200, 80):
        quick = decode(data, side).pixels
        exact = cv2.resize(whole, quick.shape[1::-1], interpolation=cv2.INTER_AREA)
        assert max(quick.shape) == side
        assert np.abs(quick.astype(int) - exact).mean() < 1
        assert np.abs(quick.astype(int) - exact).max() <= 6
    odd = decode(saved(picture(width=641, height=481), "JPEG"), 160).pixels
    assert odd.shape == (120, 160, 3)


def test_masks_zero_is_ignored_any_other_value_counts():
    header = open_header(saved(picture()))
    drawn = np.zeros((40, 48), np.uint8)
    drawn[:20], drawn[20:30] = 1, 255
    mask = decode_mask(saved(drawn), header, 1600)
    np.testing.assert_array_equal(mask, drawn > 0)
    half = decode_mask(saved(drawn), header, 24)
    np.testing.assert_array_equal(half, drawn[::2, ::2] > 0)
    twice = decode_mask(saved(np.kron(drawn, np.ones((2, 2), np.uint8))), header, 1600)  # drawn at another scale
    np.testing.assert_array_equal(twice, drawn > 0)
    with pytest.raises(UnusableError, match="its mask is 40x40 px, the photo 48x40"):
        decode_mask(saved(drawn[:, :40]), header, 1600)


def test_a_mask_drawn_on_the_stored_pixels_turns_with_the_photo():
    exif = Image.Exif()
    exif[ORIENTATION] = 6
    header = open_header(saved(picture(), exif=exif))
    drawn = np.zeros((40, 48), np.uint8)
    drawn[:5] = 255
    np.testing.assert_array_equal(decode_mask(saved(drawn), header, 1600), np.rot90(drawn > 0, -1))
    np.testing.assert_array_equal(decode_mask(saved(np.rot90(drawn, -1)), header, 1600), np.rot90(drawn > 0, -1))


def test_png_round_trip():
    np.testing.assert_array_equal(decode(encode_png(picture()), 1600).pixels, picture())
    mask = picture()[..., 0] > 128
    back = cv2.imdecode(np.frombuffer(encode_png(mask), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(back, np.where(mask, 255, 0))


def test_sizes():
    header = open_header(saved(picture(width=48, height=40)))
    assert decoded_size(header, 24) == (24, 20)
    assert decoded_size(header, 4000) == (48, 40)
    assert same_shape((4000, 3000), (1600, 1200))
    assert same_shape((1081, 1920), (901, 1600))
    assert not same_shape((4000, 3000), (3000, 4000))
