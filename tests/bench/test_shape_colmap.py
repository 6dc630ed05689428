"""COLMAP as it comes: what it is given, what is kept, what a process cost."""

import json

import numpy as np
import pytest
from PIL import Image

from bench import child_process
from bench.shape_colmap import SPENT, colmap_result, fingerprint, upright
from graphgs.synth import StreetConfig, write_street


def test_turned_photos_are_turned_for_colmap_and_others_linked(tmp_path):
    folder = tmp_path / "images"
    (folder / "cam1").mkdir(parents=True)
    pixels = np.zeros((4, 6, 3), np.uint8)
    pixels[0, 0] = 255
    turned = Image.Exif()
    turned[0x0112] = 6  # rotate by 90 degrees clockwise to see it upright
    turned[0x010F] = "Maker"
    Image.fromarray(pixels).save(folder / "a.png", exif=turned)
    Image.fromarray(pixels).save(folder / "cam1" / "b.png")
    upright(folder, ("a.png", "cam1/b.png"), tmp_path / "given")
    with Image.open(tmp_path / "given" / "a.png") as found:
        assert found.size == (4, 6)
        assert np.asarray(found)[0, 3].max() == 255
        assert found.getexif().get(0x0112, 1) == 1
        assert found.getexif()[0x010F] == "Maker"
    assert (tmp_path / "given" / "cam1" / "b.png").resolve() == (folder / "cam1" / "b.png").resolve()
    upright(folder, ("a.png", "cam1/b.png"), tmp_path / "given")  # once more changes nothing


def test_other_photos_have_another_place_in_the_cache(tmp_path):
    (tmp_path / "a.png").write_bytes(b"1")
    (tmp_path / "b.png").write_bytes(b"2")
    both = fingerprint(tmp_path, ("a.png", "b.png"))
    assert both != fingerprint(tmp_path, ("a.png",))
    (tmp_path / "b.png").write_bytes(b"3")
    assert both != fingerprint(tmp_path, ("a.png", "b.png"))


def test_a_process_is_charged_for_its_children(tmp_path, monkeypatch):
    (tmp_path / "busy.py").write_text(
        "import subprocess, sys\n"
        "loop = 'import time\\nwhile time.process_time() < 0.6: pass'\n"
        "print('started', sys.argv[1], flush=True)\n"
        "sys.exit(subprocess.run([sys.executable, '-c', loop]).returncode + 7)\n"
    )
    monkeypatch.setattr(child_process, "ROOT", tmp_path)
    ended = child_process.run_module("busy", ["well"], log=tmp_path / "log.txt")
    assert ended.returncode == 7
    assert ended.cpu_s > 0.6  # burnt by the child's child
    assert "started well" in (tmp_path / "log.txt").read_text()


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    config = StreetConfig(frames=6, width=320, height=180, texels_per_m=24.0, points=300, depth=False, exif=False)
    return write_street(config, tmp_path_factory.mktemp("drive"))


def test_colmap_places_a_drive_once_and_its_seconds_add_up(drive, tmp_path):
    names = drive.reconstruction.names
    first = colmap_result(tmp_path, "drive", drive.images, names)
    assert first.model is not None
    assert len(first.model.names) >= 5
    assert {camera.model for camera in first.model.cameras} == {"SIMPLE_RADIAL"}
    assert len(first.model.cameras) == 1
    (folder,) = (tmp_path / "colmap").iterdir()
    parts = [json.loads((folder / f"{step}.json").read_text())["cpu_s"] for step in ("features", "matches", "models")]
    assert first.cpu_s == pytest.approx(sum(parts))
    assert min(parts) > 0

    (folder / "matches.json").unlink()  # as if matching had been killed after an hour
    (folder / SPENT).write_text(json.dumps({"cpu_s": 3600.0}))
    again = colmap_result(tmp_path, "drive", drive.images, names)
    assert again.cpu_s > 3600 + parts[0] + parts[2]
    np.testing.assert_array_equal(again.model.centers, first.model.centers)
