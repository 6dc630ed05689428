"""The report is one safe page that loads nothing, for finished, partial and failed runs of any size."""

import html
import itertools
import re
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from graphgs.evaluation.report import (
    CameraFigures,
    Check,
    HeldOutFigures,
    HeldOutView,
    OutputFile,
    PairFigures,
    PhotoGroup,
    ReportData,
    StructureFigures,
    TrainingCurve,
    UnusedPhoto,
    numbers,
    write_report,
)
from graphgs.evaluation.report.camera_map import camera_map, viewing_plane
from graphgs.evaluation.report.held_out import MAX_SHOWN, chosen
from graphgs.evaluation.report.html import VOID, element, escape, join

EVIL = "<script>alert('x')</script>\"&\u202e\x07\udcff.jpg"
RESOURCE = {"src", "href", "action", "data", "poster", "srcset", "formaction", "background"}


class Page(HTMLParser):
    """Checks that tags nest, and collects text, tags and everything that could fetch."""

    def __init__(self, text: str):
        super().__init__(convert_charrefs=True)
        self.open, self.tags, self.links, self.text, self.ids = [], [], [], "", set()
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for key, value in attrs if key in RESOURCE]
        self.ids |= {value for key, value in attrs if key == "id"}
        assert not any(key.startswith("on") for key, _ in attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not self.open or self.open[-1] not in ("script", "style"):
            self.text += data


def orbit(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Cameras on a circle in the plane z = 0, world up +z, looking at its middle."""
    angles = np.linspace(0, 1.5 * np.pi, count)
    centers = np.stack([3 * np.cos(angles), 3 * np.sin(angles), 0 * angles], axis=1)
    forward = -centers / 3
    down = np.tile([0.0, 0.0, -1.0], (count, 1))
    return centers, np.stack([np.cross(down, forward), down, forward], axis=1)


def cameras(count: int, edge_count: int, **fields) -> CameraFigures:
    rng = np.random.default_rng(0)
    centers, rotations = orbit(count)
    i = rng.integers(0, max(count - 1, 1), edge_count)
    edges = np.stack([i, np.minimum(i + 1 + rng.integers(0, 5, edge_count), count - 1)], axis=1).reshape(-1, 2)
    values = {
        "names": tuple(f"{k:04d}.jpg" for k in range(count)),
        "centers": centers,
        "rotations": rotations,
        "edges": edges,
        "inliers": rng.integers(15, 900, edge_count),
        "is_test": np.arange(count) % 8 == 0,
        "importance": rng.random(count),
    }
    return CameraFigures(**values | fields)


def held_out(folder: Path, count: int, side: int = 24) -> HeldOutFigures:
    folder.mkdir(exist_ok=True)
    views = []
    for k in range(count):
        paths = [folder / f"{k}.{kind}.png" for kind in ("truth", "render", "error")]
        for path in paths:
            cv2.imwrite(str(path), np.full((side, side * 2, 3), 10 * (k % 20), np.uint8))
        views.append(HeldOutView(f"{k:04d}.jpg", 20.0 + k % 7, 0.8, *paths))
    psnr = float(np.mean([view.psnr for view in views])) if views else None
    return HeldOutFigures(tuple(views), psnr, 0.8 if views else None)


def report(folder: Path, **fields) -> ReportData:
    rng = np.random.default_rng(1)
    values = {
        "title": "a scene",
        "status": "complete",
        "command": "graphgs run photos out",
        "device": "CPU, 2 threads",
        "versions": {"graphgs": "0.1.0"},
        "settings": {"training": {"steps": 2000, "masks": None, "antialiased": False, "limits": (2.0, 10.0)}},
        "photos_used": tuple(f"{k:04d}.jpg" for k in range(20)),
        "photos_unused": (UnusedPhoto("half.jpg", "cut short"),),
        "pairs": PairFigures(60, 190, 55, {"neighbour": 40, "ring": 30}),
        "cameras": cameras(20, 55),
        "structure": StructureFigures(
            rng.gamma(2, 0.3, 500), rng.integers(2, 9, 500), "triangulation", "500 px", (Check("a", "1", "2", True),)
        ),
        "training": TrainingCurve(np.arange(0, 2000, 10), rng.random(200) + 0.1, np.linspace(1e3, 9e4, 200)),
        "tests": held_out(folder / "pictures", 3),
        "num_splats": 90_000,
        "steps_executed": 2000,
        "stage_seconds": {"matching": 60.0, "training": 400.0},
        "peak_rss_bytes": 2_000_000_000,
        "outputs": (OutputFile("splat.ply", "the scene", "any viewer"),),
    }
    return ReportData(**values | fields)


def written(folder: Path, data: ReportData) -> tuple[Page, str]:
    write_report(folder / "out" / "report.html", data)
    assert [path.name for path in (folder / "out").iterdir()] == ["report.html"]
    text = (folder / "out" / "report.html").read_text(encoding="utf-8")
    return Page(text), text


def test_a_finished_run_shows_everything_and_loads_nothing(tmp_path):
    page, text = written(tmp_path, report(tmp_path))
    expected = ["a scene", "Complete", "graphgs run photos out", "90,000", "7 min 40 s", "2.00 GB", "half.jpg"]
    expected += ["cut short", "splat.ply", "31.6 % of all 190", "LPIPS not measured", "PSNR 21.00 dB"]
    assert [words for words in expected if words not in page.text] == []
    assert page.tags.count("img") == 9
    assert page.tags.count("svg") == 5
    for link in page.links:
        assert link.startswith("data:image/jpeg;base64,") or link[1:] in page.ids, link[:40]
    assert not re.search(r"url\(|@import|https?://(?!www\.w3\.org)", text)
    assert "default-src 'none'" in html.unescape(text)


def test_names_cannot_inject_markup(tmp_path):
    tests = held_out(tmp_path, 1)
    view = HeldOutView(EVIL, 20.0, 0.5, tests.views[0].truth, tests.views[0].render, tests.views[0].error)
    data = report(
        tmp_path,
        title=EVIL,
        status="partial",
        cause=EVIL,
        next_step=EVIL,
        command=EVIL,
        device=EVIL,
        versions={EVIL: EVIL},
        settings={EVIL: {EVIL: EVIL}},
        photos_used=(EVIL,),
        photos_unused=(UnusedPhoto(EVIL, EVIL),),
        pairs=PairFigures(1, 2, 1, {EVIL: 1}, EVIL),
        cameras=cameras(
            20, 50, names=(EVIL,) * 20, unregistered=(EVIL,), beside=np.array([3]), groups=(PhotoGroup(EVIL, 2, EVIL),)
        ),
        structure=StructureFigures(np.ones(3), np.full(3, 2), EVIL, EVIL, (Check(EVIL, EVIL, EVIL, False),)),
        tests=HeldOutFigures((view,), 20.0, 0.5, missing=(EVIL,)),
        stage_seconds={EVIL: 1.0},
        warnings=(EVIL,),
        outputs=(OutputFile(EVIL, EVIL, EVIL),),
    )
    page, text = written(tmp_path, data)
    assert page.tags.count("script") == 1
    assert "<script>alert" not in text
    assert not set("\u202e\x07") & set(text)
    assert "<script>alert('x')</script>\"&\\u202e\\u0007\\udcff.jpg" in page.text


def test_a_partial_run_has_its_cause_on_top_and_no_empty_section(tmp_path):
    data = report(
        tmp_path,
        status="partial",
        cause="17 of 20 photos could be placed",
        next_step="add photos, or --allow-partial",
        training=None,
        tests=None,
        num_splats=None,
        steps_executed=None,
        cameras=cameras(17, 40, unregistered=("lost1.jpg", "lost2.jpg")),
    )
    page, _ = written(tmp_path, data)
    assert "Partial: not trained" in page.text
    assert page.text.index("17 of 20 photos could be placed") < page.text.index("Photos used")
    assert page.text.index("--allow-partial") < page.text.index("Photos used")
    assert "2 not placed: lost1.jpg, lost2.jpg" in page.text
    assert {"test-views", "training"}.isdisjoint(page.ids)
    assert {"cameras", "reconstruction", "photos"} <= page.ids


def test_a_failed_run_needs_almost_nothing(tmp_path):
    page, _ = written(tmp_path, ReportData("x", "failed", cause="no matches", photos_unused=(UnusedPhoto("a", "b"),)))
    assert "Failed" in page.text
    assert "no matches" in page.text
    assert page.ids == {"photos"}


@pytest.mark.parametrize(("views", "missing"), [(0, ()), (0, ("gone.jpg",)), (1, ("gone.jpg",))])
def test_few_test_views(tmp_path, views, missing):
    figures = held_out(tmp_path, views)
    page, _ = written(
        tmp_path, report(tmp_path, tests=HeldOutFigures(figures.views, figures.psnr, figures.ssim, missing=missing))
    )
    assert page.tags.count("img") == 3 * views
    assert ("gone.jpg" in page.text) == bool(missing)
    assert ("Test PSNR" in page.text) == bool(views)


def test_many_test_views_show_worst_and_best_and_list_all(tmp_path):
    figures = held_out(tmp_path, 75)
    page, _ = written(tmp_path, report(tmp_path, tests=figures))
    assert page.tags.count("img") == 3 * MAX_SHOWN
    assert "12 of 75 are shown" in page.text
    assert all(view.name in page.text for view in figures.views)
    scores = [view.psnr for view in figures.views]
    shown = [scores[k] for k in chosen(figures.views)]
    assert {min(scores), max(scores)} <= set(shown)


def test_a_missing_picture_is_said(tmp_path):
    figures = held_out(tmp_path, 1)
    figures.views[0].render.unlink()
    figures.views[0].error.write_bytes(b"no picture")
    page, _ = written(tmp_path, report(tmp_path, tests=figures))
    assert page.tags.count("img") == 1
    assert page.text.count("picture not found") == 2


@pytest.mark.parametrize(("width", "layout"), [(18, "portrait"), (36, "landscape"), (80, "panorama")])
def test_the_layout_follows_the_shape_of_the_pictures(tmp_path, width, layout):
    figures = held_out(tmp_path, 2)
    for view in figures.views:
        for path in (view.truth, view.render, view.error):
            cv2.imwrite(str(path), np.zeros((24, width, 3), np.uint8))
    _, text = written(tmp_path, report(tmp_path, tests=figures))
    assert f'class="views {layout}"' in text


def test_pictures_are_made_small(tmp_path):
    _, text = written(tmp_path, report(tmp_path, tests=held_out(tmp_path, 1, side=1100)))
    assert 'width="960" height="480"' in text
    assert len(text) < 200_000


@pytest.mark.parametrize(
    "values",
    [
        {"errors": np.zeros(0), "track_lengths": np.zeros(0, int)},
        {"errors": np.full(4, np.nan), "track_lengths": np.full(4, 2)},
        {"errors": np.zeros(9), "track_lengths": np.full(9, 900)},
        {"errors": np.array([0.1] * 500 + [1e6]), "track_lengths": np.arange(2, 503)},
    ],
    ids=["none", "nan", "equal", "outlier"],
)
def test_odd_structures_are_drawn(tmp_path, values):
    _, text = written(tmp_path, report(tmp_path, structure=StructureFigures(**values)))
    _drawings(text)


def test_odd_curves_are_drawn(tmp_path):
    for loss in ([], [0.3], [np.nan, 0.2, np.inf], [0.0, 0.0], [1e-3, 1.0, 50.0]):
        steps = np.arange(len(loss))
        _, text = written(tmp_path, report(tmp_path, training=TrainingCurve(steps, np.array(loss), steps * 10)))
        _drawings(text)


@pytest.mark.parametrize("count", [0, 1, 2, 600])
def test_any_number_of_cameras_is_drawn_inside_the_picture(tmp_path, count):
    _, text = written(tmp_path, report(tmp_path, cameras=cameras(count, 5000 if count > 2 else 0)))
    drawings = [svg for svg in _drawings(text) if svg.get("class") == "map"]
    assert len(drawings) == bool(count)
    for svg in drawings:
        _, _, width, height = map(float, svg.get("viewBox").split())
        marks = [mark for mark in svg.iter() if (mark.get("class") or "").startswith("camera")]
        assert len(marks) == count
        for mark in marks:
            diamond = mark.get("d")
            at = diamond[1:].split("L")[0].split() if diamond else (mark.get("cx"), mark.get("cy"))
            px, py = map(float, at)
            assert 0 <= px <= width
            assert 0 <= py <= height
    assert len(text) < 600_000


def test_coincident_cameras_are_drawn(tmp_path):
    _, text = written(tmp_path, report(tmp_path, cameras=cameras(20, 55, centers=np.ones((20, 3)))))
    _drawings(text)


def test_the_map_is_seen_from_above_and_not_mirrored():
    centers, rotations = orbit(12)
    plane = viewing_plane(centers, rotations)
    assert plane.seen == "from above"
    np.testing.assert_allclose(
        np.cross(plane.right, -plane.down), [0, 0, 1], atol=1e-9
    )  # right x up = towards the onlooker


def test_a_straight_track_is_seen_from_above():
    rng = np.random.default_rng(0)
    centers = np.stack([np.arange(30.0), 0.01 * rng.normal(size=30), 0.2 * rng.normal(size=30)], axis=1)
    rotations = np.tile(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), (30, 1, 1))  # forward +x, up +z
    plane = viewing_plane(centers, rotations)
    assert plane.seen == "from above"
    assert abs(plane.right[0]) > 0.999
    assert abs(plane.down[1]) > 0.99


def test_a_wall_of_cameras_is_seen_from_behind_and_upright():
    grid = np.stack(np.meshgrid(np.arange(6.0), [0.0], np.arange(5.0)), axis=-1).reshape(-1, 3)
    rotations = np.tile(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), (30, 1, 1))  # forward +y, up +z
    plane = viewing_plane(grid, rotations)
    assert plane.seen == "from behind the cameras"
    np.testing.assert_allclose(plane.down, [0, 0, -1], atol=1e-9)
    np.testing.assert_allclose(plane.right, [1, 0, 0], atol=1e-9)


def test_with_a_compass_north_is_up_and_lengths_are_metres(tmp_path):
    centers = np.array([[0.0, 0, 2], [30, 0, 2], [0, 40, 2]])  # the second stands east of the first, the third north
    facing = np.tile(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), (3, 1, 1))
    fields = {"centers": centers, "rotations": facing, "edges": np.array([[0, 1]]), "inliers": np.array([20])}
    figures = cameras(3, 0, **fields, compass=True, unit="m", is_test=np.zeros(3, bool))
    drawn = camera_map(figures)
    dots = [(float(c.get("cx")), float(c.get("cy"))) for c in ET.fromstring(drawn.svg) if c.get("class") == "camera"]
    here, east, north = np.array(dots)
    np.testing.assert_allclose((east - here) / (east[0] - here[0]), [1, 0], atol=0.01)
    np.testing.assert_allclose((north - here) / (here[1] - north[1]), [0, -1], atol=0.01)
    assert "north up" in drawn.seen
    page, _ = written(tmp_path, report(tmp_path, cameras=figures))
    assert re.search(r"Scale bar: \d+ m\.", page.text)


def test_photos_and_pairs_that_do_not_fit_are_red(tmp_path):
    lost = tuple(f"lost{k}.jpg" for k in range(4))
    figures = cameras(
        12,
        30,
        unregistered=lost,
        beside=np.array([3, 3, 7, -1]),  # the last shares nothing with any camera: it is only listed
        objections=np.array([[0, 9], [2, 11]]),
        groups=(PhotoGroup("day", 12), PhotoGroup("night", 3, "take photos from a.jpg to b.jpg")),
    )
    shapes = list(ET.fromstring(camera_map(figures).svg))
    crosses = [shape for shape in shapes if shape.get("class") == "lost"]
    assert len(crosses) == 3
    assert len({cross.get("d") for cross in crosses}) == 3  # two at one camera stand apart
    assert "lost2.jpg: not placed; shares most with 0007.jpg" in crosses[2][0].text
    (objections,) = [shape for shape in shapes if shape.get("class") == "objection"]
    assert objections.get("d").count("M") == 2
    page, text = written(tmp_path, report(tmp_path, cameras=figures))
    _drawings(text)
    for words in (
        "4 not placed: lost0.jpg",
        "contradicts the poses",
        "take photos from a.jpg to b.jpg",
        "the one that is kept",
    ):
        assert words in page.text


def test_edge_classes_cover_every_edge_once():
    figures = cameras(50, 400)
    drawn = camera_map(figures)
    lines = [path for path in ET.fromstring(drawn.svg) if path.get("class").startswith("edge")]
    assert sum(path.get("d").count("M") for path in lines) == 400
    ranges = [[int(v.replace(",", "")) for v in words.split("–")] for _, words in drawn.edge_classes]
    assert ranges[0][0] == figures.inliers.min()
    assert ranges[-1][-1] == figures.inliers.max()
    assert all(a[-1] < b[0] for a, b in itertools.pairwise(ranges))


def test_markup_is_escaped_unless_it_is_markup():
    assert element("p", "<b>", element("i", "&"), None, ["x", 3], title='"', hidden=True, lang=None) == (
        '<p title="&quot;" hidden>&lt;b&gt;<i>&amp;</i>x3</p>'
    )
    assert escape(escape("<")) == "&lt;"
    assert join("a", [["b"], None]) == "ab"


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (numbers.seconds(9.94), "9.9 s"),
        (numbers.seconds(59.7), "1 min 00 s"),
        (numbers.seconds(3599.6), "1 h 00 min"),
        (numbers.percent(1, 0), "–"),
        (numbers.percent(1, 5000), "< 0.1 %"),
        (numbers.percent(3, 3), "100 %"),
        (numbers.short(1500), "1.5k"),
        (numbers.short(1e6), "1M"),
        (numbers.ticks(0, 1998, count=4), [0, 500, 1000, 1500, 2000]),
        (numbers.ticks(0, 3, count=6, integer=True), [0, 1, 2, 3]),
        (numbers.ticks(0, 0, count=5), [0]),
    ],
)
def test_numbers_are_written_for_people(said, expected):
    assert said == expected


def _drawings(text: str) -> list[ET.Element]:
    """The page's SVGs, parsed as XML; no coordinate is nan or inf."""
    found = re.findall(r"<svg.*?</svg>", text, flags=re.DOTALL)
    assert not any(re.search(r'[" ](nan|inf|-inf)\b', svg) for svg in found)
    return [ET.fromstring(svg) for svg in found]
