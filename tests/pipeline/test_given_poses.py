"""What the commands make of poses that came with the photos: `check` says what `pose` says."""

import json

import pytest

from graphgs import cli
from graphgs.scene.colmap import read_model
from graphgs.synth.street import StreetConfig, write_street
from tests.support.given_poses import colmap_project, transforms_json, with_points_moved

ONE_THREAD = ["--threads", "1"]


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    config = StreetConfig(frames=8, width=320, height=180, depth=False, points=2000)
    return write_street(config, tmp_path_factory.mktemp("street"))


def run(*arguments) -> int:
    return cli._guarded([str(a) for a in arguments] + ONE_THREAD)


def test_right_poses_are_kept_and_their_figures_written(street, tmp_path, capsys):
    source, scene = colmap_project(street, tmp_path / "in"), tmp_path / "out"
    assert run("check", source) == 0
    assert "the given poses fit the photos" in capsys.readouterr().out
    assert run("pose", source, scene) == 0
    metrics = json.loads((scene / "metrics.json").read_text())
    assert metrics["cautions"] == []
    assert metrics["given_poses"]["verdict"] == "fits"
    assert metrics["given_poses"]["matches"]["median_px"] < 0.5
    assert metrics["given_poses"]["observations"]["contradicted"] < 0.01
    assert "matches that contradict the given poses" in (scene / "report.html").read_text()
    assert run("pose", source, scene) == 0  # again, from what is there
    assert json.loads((scene / "metrics.json").read_text())["given_poses"] == metrics["given_poses"]


def test_wrong_axes_end_check_and_pose_alike_and_the_option_mends_them(street, tmp_path, capsys):
    source, scene = transforms_json(street, tmp_path / "in", axes="opencv"), tmp_path / "out"
    said = []
    for command in (("check", source), ("pose", source, scene)):
        assert run(*command) == 3
        said.append(capsys.readouterr().err)
        assert "they fit with the cameras' y and z axes flipped" in said[-1]
        assert "use --given-axes opencv" in said[-1]
    assert said[0] == said[1]
    assert not (scene / "metrics.json").exists()
    assert run("pose", source, scene, "--given-axes", "opencv") == 0
    assert json.loads((scene / "metrics.json").read_text())["cautions"] == []


def test_who_insists_on_refused_points_gets_a_caution(street, tmp_path, capsys):
    source = colmap_project(street, tmp_path / "in", with_points_moved(street.reconstruction))
    assert run("pose", source, tmp_path / "out") == 3
    assert "sources.given_points=drop" in capsys.readouterr().err
    assert run("pose", source, tmp_path / "out", "--allow-partial") == 0
    (caution,) = json.loads((tmp_path / "out" / "metrics.json").read_text())["cautions"]
    assert "another frame" in caution
    assert run("pose", source, tmp_path / "mended", "--set", "sources.given_points=drop") == 0
    assert json.loads((tmp_path / "mended" / "metrics.json").read_text())["cautions"] == []
    assert len(read_model(tmp_path / "mended" / "colmap" / "original").points) > 100
