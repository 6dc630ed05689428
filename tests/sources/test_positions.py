"""GPS positions from CSV and GeoJSON files of many spellings."""

import json

import pytest

from graphgs.errors import DataError, UsageError
from graphgs.sources.positions import read_positions

PHOTOS = ("a.jpg", "b.jpg", "c.jpg")
TRUTH = {"a.jpg": (55.7, 13.19, 40.0), "b.jpg": (55.71, 13.2, 41.5), "c.jpg": (-5.0, 13.21, 39.0)}


def geojson(names=PHOTOS, key="name"):
    points = [
        {"type": "Feature", "geometry": {"type": "Point", "coordinates": [lon, lat, alt]}, "properties": {key: name}}
        for name, (lat, lon, alt) in TRUTH.items()
        if name in names
    ]
    track = {"type": "Feature", "geometry": {"type": "LineString", "coordinates": [[0, 0], [1, 1]]}, "properties": None}
    return json.dumps({"type": "FeatureCollection", "features": [track, *points]})


@pytest.mark.parametrize(
    "text",
    [
        "name,lat,lon,alt\na.jpg,55.7,13.19,40\nb.jpg,55.71,13.2,41.5\nc.jpg,-5,13.21,39\n",
        "\ufeffFileName; Longitude; Latitude; Height\na.jpg;13.19;55.7;40\nb.jpg;13.2;55.71;41.5\nc.jpg;13.21;-5;39",
        "# made by hand\nlng\tlat\tele\tspeed\tphoto\n"
        "13.19\t55.7\t40\t3\ta.jpg\n13.2\t55.71\t41.5\t\tb.jpg\n13.21\t-5\t39\t\tc.jpg",
        "image,GPS Latitude,GPS Longitude,z\n"
        "images/a.jpg,55.7,13.19,40\nimages/b.jpg,55.71,13.2,41.5\nimages/c.jpg,-5,13.21,39",
        "name,lat,lon,alt\na,55.7,13.19,40\nb,55.71,13.2,41.5\nc,-5,13.21,39\n",
        geojson(),
        geojson(key="Filename"),
    ],
)
def test_spellings(tmp_path, text):
    (tmp_path / "gps").write_text(text, encoding="utf-8")
    assert read_positions(tmp_path / "gps", PHOTOS) == TRUTH


def test_what_is_missing(tmp_path):
    file = tmp_path / "gps.csv"
    file.write_text("name,lat,lon,alt\na.jpg,1,2,10\nb.jpg,1,3,\nc.jpg,1,4,30\nother.jpg,9,9,9\n../b.jpg,8,8,8")
    assert read_positions(file, PHOTOS) == {"a.jpg": (1, 2, 10), "b.jpg": (1, 3, 20), "c.jpg": (1, 4, 30)}
    file.write_text("name,lat,lon\nb.jpg,1,3")
    assert read_positions(file, PHOTOS) == {"b.jpg": (1, 3, 0)}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "empty"),
        ("name,lat\na.jpg,1", "no column for the longitude"),
        ("name,lat,lon\na.jpg,north,1", "row 2.*no numbers"),
        ("name,lat,lon\na.jpg,1,1\nb.jpg,nan,1", "row 3.*no place on Earth"),
        ("name,lat,lon\na.jpg,91,1", "no place on Earth"),
        ("name,lat,lon\na.jpg", "no numbers"),
        ("name,lat,lon\nx.jpg,1,1", "names a photo"),
        ("{}", "no points"),
        ("{", "no list of positions"),
        ('{"features": [7]}', "no points"),
        ('{"features": [{"geometry": {"type": "Point", "coordinates": 7}, "properties": {}}]}', "no coordinates"),
    ],
)
def test_files_that_cannot_be_used(tmp_path, text, reason):
    (tmp_path / "gps").write_text(text)
    with pytest.raises(DataError, match=reason) as caught:
        read_positions(tmp_path / "gps", PHOTOS)
    assert caught.value.hint
    with pytest.raises(UsageError, match="does not exist"):
        read_positions(tmp_path / "none", PHOTOS)
