"""Whole runs in which COLMAP's process dies: they end right, or say what they left out."""

import json
import signal
from pathlib import Path

import cv2
import pytest

from graphgs import api
from graphgs.explain import read_artefacts, scene_facts
from tests.support.dying_worker import deaths, dies_of
from tests.support.hard_scenes import corner

SMALL = ("structure.fine_features=1000",)


@pytest.fixture
def photos(tmp_path) -> Path:
    (tmp_path / "in").mkdir()
    for k, image in enumerate(corner(tmp_path / "a", count=6).images):
        cv2.imwrite(str(tmp_path / "in" / f"{k}.png"), image)
    return tmp_path / "in"


@pytest.mark.parametrize(("job", "number"), [("match", signal.SIGKILL), ("triangulate", signal.SIGSEGV)])
def test_a_death_in_the_middle_changes_nothing(photos, tmp_path, monkeypatch, job, number):
    dies_of(monkeypatch, tmp_path, signal=number, jobs=[job], once=str(tmp_path / "once"))
    result = api.pose(photos, tmp_path / "scene", threads=1, settings_extra=SMALL)
    assert deaths(tmp_path) == 1
    assert result.status == "posed"
    assert result.metrics["registered"] == 6
    assert not any("COLMAP" in caution for caution in result.metrics["cautions"])


def test_a_pair_that_kills_every_worker_is_named_in_every_output(photos, tmp_path, monkeypatch):
    dies_of(monkeypatch, tmp_path, signal=signal.SIGABRT, pairs=[[1, 4]])
    result = api.pose(photos, tmp_path / "scene", threads=1, settings_extra=SMALL)
    assert result.metrics["registered"] == 6
    sentence = "matching 1.png with 4.png ends COLMAP's process (SIGABRT) every time; this pair is left out"
    assert sentence in result.metrics["cautions"]
    assert sentence in json.loads((tmp_path / "scene" / "metrics.json").read_text())["cautions"]
    assert sentence in scene_facts(read_artefacts(tmp_path / "scene"))["cautions"]
    assert "1.png with 4.png ends COLMAP" in (tmp_path / "scene" / "report.html").read_text()


@pytest.mark.slow
def test_a_photo_that_kills_every_worker_is_left_out_with_that_reason(photos, tmp_path, monkeypatch):
    dies_of(monkeypatch, tmp_path, signal=signal.SIGKILL, photos=[5])
    result = api.pose(photos, tmp_path / "scene", threads=1, settings_extra=SMALL)
    assert result.metrics["registered"] == 5
    assert list(result.metrics["left_out"]) == ["5.png"]
    assert "ends COLMAP's process (SIGKILL)" in result.metrics["left_out"]["5.png"]
    assert result.status == "posed"
