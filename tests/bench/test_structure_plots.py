"""The pictures of the noise experiment."""

import json
from xml.etree import ElementTree

from bench.structure_plots import COLORS, main, picture

SVG = "{http://www.w3.org/2000/svg}"


def rows():
    """Two selectors at two levels, and one that looks at no pose."""
    moving = [
        {"photos": 60, "noise": noise, "selector": name, "matching_s": 3.0 + noise, "error": 0.02 + noise}
        for name in ("graphgs", "spatial")
        for noise in (0.0, 0.3)
    ]
    return [*moving, {"photos": 60, "noise": 0.0, "selector": "exhaustive", "matching_s": 17.0, "error": 0.03}]


def test_each_selector_has_a_line_per_panel_and_a_name():
    root = ElementTree.fromstring(picture(rows()))
    strokes = [path.get("stroke") for path in root.iter(f"{SVG}path")]
    for name in ("graphgs", "spatial", "exhaustive"):
        assert strokes.count(COLORS[name]) == 3  # two panels and the legend
    assert COLORS["sequential"] not in strokes
    words = {text.text for text in root.iter(f"{SVG}text")}
    assert {"graphgs (gate)", "spatial", "exhaustive", "matching, CPU s"} <= words
    assert len(list(root.iter(f"{SVG}circle"))) == 8  # a line without noise has no points


def test_every_stored_size_becomes_a_file(tmp_path):
    (tmp_path / "noise_60.json").write_text(json.dumps(rows()))
    main(tmp_path, tmp_path)
    assert (tmp_path / "structure_noise_60.svg").read_text().startswith("<svg")
