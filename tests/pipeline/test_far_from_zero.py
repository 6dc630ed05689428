"""A model in a frame of the earth trains as the same model near zero, and is written back where it came from."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from graphgs import cli
from graphgs.scene.colmap import read_model, write_model
from graphgs.scene.origin import moved, moved_back
from graphgs.scene.reconstruction import Reconstruction
from graphgs.synth.street import StreetConfig, write_street

UTM = (453210.0, 5412345.0, 312.0)
OPTIONS = ["--device", "cpu", "--threads", "2", "--preset", "preview", "--steps", "150"]
POINTS = ["--set", "points.dense=none", "--max-splats", "4000"]


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    config = StreetConfig(frames=12, width=240, height=136, points=6000, depth=False)
    return write_street(config, tmp_path_factory.mktemp("street"))


def run(street, model: Reconstruction, folder: Path) -> dict:
    """Train on the street with this model as its input; the metrics."""
    shutil.copytree(street.images, folder / "in" / "images")
    write_model(model, folder / "in" / "sparse" / "0")
    before = {file.name: file.read_bytes() for file in (folder / "in" / "sparse" / "0").iterdir()}
    assert cli._guarded(["run", str(folder / "in"), str(folder / "out"), *OPTIONS, *POINTS]) == 0
    assert before == {file.name: file.read_bytes() for file in (folder / "in" / "sparse" / "0").iterdir()}
    return json.loads((folder / "out" / "metrics.json").read_text())


def positions(file: Path) -> tuple[str, np.ndarray]:
    """(header, [N, 3] float32 x, y, z) of a splat.ply."""
    data = file.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    return data[:end].decode(), np.frombuffer(data[end:], "<f4").reshape(-1, 62)[:, :3]


def test_a_model_in_utm_trains_as_well_as_one_near_zero(street, tmp_path, capsys):
    truth = street.reconstruction
    near = moved(truth, tuple(np.round(np.median(truth.centers, axis=0))))
    far = moved_back(near, UTM)
    plain = run(street, near, tmp_path / "near")
    assert "far from zero" not in capsys.readouterr().out
    shifted = run(street, far, tmp_path / "far")
    assert "the scene is kept about (4532" in capsys.readouterr().out
    assert plain["origin"] == [0.0, 0.0, 0.0]
    np.testing.assert_allclose(shifted["origin"], UTM, atol=4.0)  # the middle, rounded
    assert plain["psnr"] == pytest.approx(shifted["psnr"], abs=0.1)

    header, places = positions(tmp_path / "far" / "out" / "splat.ply")
    assert "comment origin {} {} {}".format(*shifted["origin"]) in header
    assert len(places) == 4000
    assert len(np.unique(places, axis=0)) == 4000
    assert len(np.unique(places[:, 1])) > 3900  # the northing too
    assert np.abs(places).max() < 1000
    assert "origin" not in positions(tmp_path / "near" / "out" / "splat.ply")[0]

    written = read_model(tmp_path / "far" / "out" / "colmap" / "original")
    np.testing.assert_allclose(written.centers, far.centers, atol=1e-6)
    np.testing.assert_allclose(written.points, far.points, atol=1e-6)
    local = read_model(tmp_path / "far" / "out" / "colmap" / "sparse" / "0")
    assert np.abs(local.centers).max() < 30
    assert "the scene is kept about" in (tmp_path / "far" / "out" / "report.html").read_text()
