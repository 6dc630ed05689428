"""EXIF facts: focal length, position, time, and tags that lie."""

from io import BytesIO

import pytest
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from graphgs.sources.decode import decoding, open_header, read_header
from graphgs.sources.exif import Exif
from tests.support.pictures import picture

B, G = ExifTags.Base, ExifTags.GPS


def exif_of(root: dict | None = None, detail: dict | None = None, gps: dict | None = None) -> Exif:
    exif = Image.Exif()
    exif.update(root or {})
    exif.get_ifd(ExifTags.IFD.Exif).update(detail or {})
    exif.get_ifd(ExifTags.IFD.GPSInfo).update(gps or {})
    out = BytesIO()
    Image.fromarray(picture(width=60, height=40)).save(out, "JPEG", exif=exif)
    return open_header(out.getvalue()).exif


def test_focal_length_of_the_35_mm_equivalent():
    found = exif_of(detail={B.FocalLengthIn35mmFilm: 28})
    assert found.focal_px(3600, 2400) == pytest.approx(2800)  # full frame is 36x24 mm
    assert found.focal_px(2400, 3600) == pytest.approx(2800)
    assert found.focal_px(1800, 1200) == pytest.approx(1400)


def test_focal_length_of_the_pixel_pitch_survives_resizing():
    detail = {
        B.FocalLength: IFDRational(5),
        B.FocalPlaneXResolution: IFDRational(254000, 1),  # per inch: 10 px per um, 10,000 per mm
        B.FocalPlaneResolutionUnit: 2,
        B.ExifImageWidth: 6000 * 10,
        B.ExifImageHeight: 4000 * 10,
    }
    assert exif_of(detail=detail).focal_px(60, 40) == pytest.approx(50)  # 50,000 px on a side of 60,000
    detail[B.FocalPlaneResolutionUnit] = 3  # per cm
    assert exif_of(detail=detail).focal_px(60, 40) == pytest.approx(127)


@pytest.mark.parametrize("film", [0, 3, 60000])
def test_impossible_focal_lengths_are_no_focal_lengths(film):
    assert exif_of(detail={B.FocalLengthIn35mmFilm: film}).focal_px(60, 40) is None


def test_camera_is_told_apart_by_make_lens_and_zoom():
    one = exif_of({B.Make: "Maker\0 ", B.Model: "X1"}, {B.FocalLength: IFDRational(24)})
    same = exif_of({B.Make: "Maker", B.Model: "X1"}, {B.FocalLength: IFDRational(24)})
    zoomed = exif_of({B.Make: "Maker", B.Model: "X1"}, {B.FocalLength: IFDRational(25)})
    assert one.camera == same.camera == "Maker X1 24.0"
    assert zoomed.camera != one.camera


def test_position():
    gps = {
        G.GPSLatitude: (55.0, 30.0, 36.0),
        G.GPSLatitudeRef: "S",
        G.GPSLongitude: (13.0, 0.0, 0.0),
        G.GPSLongitudeRef: "W",
        G.GPSAltitude: 12.5,
        G.GPSAltitudeRef: b"\x01",
    }
    assert exif_of(gps=gps).gps == pytest.approx((-55.51, -13.0, -12.5))
    del gps[G.GPSAltitude]
    assert exif_of(gps=gps).gps == pytest.approx((-55.51, -13.0, 0.0))
    assert exif_of(gps=gps | {G.GPSLatitude: (95.0, 0.0, 0.0)}).gps is None
    assert exif_of(gps=gps | {G.GPSLatitude: (0.0, 0.0, 0.0), G.GPSLongitude: (0.0, 0.0, 0.0)}).gps is None
    assert exif_of().gps is None


def test_time():
    assert exif_of(detail={B.DateTimeOriginal: "1970:01:02 00:00:01", B.SubsecTimeOriginal: "25"}).time == 86401.25
    assert exif_of({B.DateTime: "1970:01:01 00:01:00"}).time == 60
    assert exif_of({B.DateTime: "yesterday"}).time is None
    assert exif_of({B.DateTime: "0000:00:00 00:00:00"}).time is None


def test_orientation_out_of_range_is_upright():
    assert exif_of({B.Orientation: 9}).orientation == 1
    assert exif_of({B.Orientation: 8}).orientation == 8


def test_broken_exif_is_no_exif():
    out = BytesIO()
    Image.fromarray(picture()).save(out, "JPEG", exif=b"Exif\0\0MM\0*\xff\xff\xff\xff junk")
    with decoding():  # no warning reaches the terminal
        assert open_header(out.getvalue()).exif == Exif()


def test_real_photos(shared_data):
    aerial = read_header(shared_data("ochota_aerial") / "images/img_3006.jpg")
    assert (aerial.width, aerial.height, aerial.exif.orientation) == (1200, 1600, 6)
    assert aerial.exif.focal_px(1200, 1600) == pytest.approx(5.0 / 25.4 * 17791.5 * 1600 / 4608, rel=1e-3)
    street = read_header(shared_data("lund_street") / "images/01.jpg")
    assert street.exif.gps == pytest.approx((55.698167, 13.195389, 37.0), abs=1e-5)
    assert street.exif.focal_px(1024, 768) == pytest.approx(1035, abs=1)
