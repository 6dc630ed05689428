"""A folder of two scenes, and one of blurred photos: what the command line says, and that all outputs say the same."""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from graphgs import cli
from tests.support.hard_scenes import corner

# The photos are 320 px wide: another attempt at more pixels brings nothing, and a folder of two scenes asks for it.
QUICKLY = ["--threads", "1"]
for setting in ("coarse_retry_max_side=400", "coarse_retry_features=500", "fine_features=1500"):
    QUICKLY += ["--set", f"structure.{setting}"]


@dataclass(frozen=True)
class Said:
    code: int
    out: str
    err: str


@pytest.fixture
def command(capsys):
    def call(*arguments) -> Said:
        code = cli._guarded([str(a) for a in arguments])
        return Said(code, *capsys.readouterr())

    return call


def write(folder: Path, images, prefix: str) -> list[str]:
    folder.mkdir(exist_ok=True)
    names = [f"{prefix}{k:02d}.png" for k in range(len(images))]
    for name, image in zip(names, images, strict=True):
        cv2.imwrite(str(folder / name), image)
    return names


def two_rooms(folder: Path, first: int, second: int) -> tuple[list[str], list[str]]:
    """Names of the photos of each room, in one folder."""
    rooms = corner(folder / "a", count=first), corner(folder / "b", count=second, seed=7)
    return tuple(write(folder / "in", room.images, prefix) for room, prefix in zip(rooms, "pq", strict=True))


@pytest.mark.parametrize(("first", "second"), [(12, 10), (14, 14)])
def test_a_part_is_called_a_part_everywhere(tmp_path, command, first, second):
    rooms = two_rooms(tmp_path, first, second)
    scene, total = tmp_path / "my scene", first + second
    said = command("pose", tmp_path / "in", scene, *QUICKLY)
    assert said.code == 3
    metrics = json.loads((scene / "metrics.json").read_text())
    kept, apart = (group["photos"] for group in metrics["groups"])
    assert sorted([kept, apart]) == sorted(rooms)
    if first > second:
        assert kept == rooms[0]
    lines = said.err.splitlines()
    title, end = lines[0].removeprefix("error: "), lines[-1].strip()
    assert title == (
        f"PARTIAL: {len(kept)} of {total} photos placed; kept is the group {kept[0]} to {kept[-1]} ({len(kept)} photos)"
        f"; without common features with it: {apart[0]} to {apart[-1]} ({len(apart)} photos)"
    )
    assert end == f"graphgs explain '{scene}'"
    # What is placed is the kept group, whatever else is said of it.
    assert metrics["registered"] == len(kept)
    assert set(metrics["left_out"]) == set(apart)
    assert (metrics["status"], metrics["partial"]) == ("partial", title)
    page = (scene / "report.html").read_text()
    assert title in page
    assert 'class="status partial"' in page
    assert f"{len(kept)} of {total} ({100 * len(kept) / total:.0f} %)" in page
    assert "Complete" not in page
    explained = command("explain", scene)
    assert explained.code == 0
    assert explained.out.splitlines()[0] == title
    assert f"{kept[0]} to {kept[-1]}: {len(kept)} photos, the one that is kept" in explained.out
    assert f"group: {apart[0]} to {apart[-1]}" in command("explain", scene, apart[1]).out
    # Asked for, a part is as good as the whole, and still called one.
    allowed = command("pose", tmp_path / "in", scene, *QUICKLY, "--allow-partial")
    assert allowed.code == 0
    ending = allowed.out.splitlines()
    assert title in ending
    assert not any(line.startswith("done:") for line in ending)
    assert json.loads((scene / "metrics.json").read_text())["status"] == "partial"


@pytest.mark.parametrize("sigma", [12, 20], ids=["hardly-matched", "not-matched"])
def test_photos_blurred_throughout_are_called_blurred(tmp_path, command, sigma):
    images = [cv2.GaussianBlur(image, (0, 0), sigma) for image in corner(tmp_path / "a", count=6).images]
    write(tmp_path / "in", images, "")
    said = command("pose", tmp_path / "in", tmp_path / "scene", *QUICKLY)
    assert said.code == 3
    assert "blurred: edges are" in said.err.splitlines()[0]
    assert "take them again, in focus" in said.err
    assert "overlap" not in said.err


def test_photos_of_nothing_are_called_so(tmp_path, command):
    rng = np.random.default_rng(0)
    write(tmp_path / "in", [rng.normal(120, 1, (240, 320, 3)).astype(np.uint8) for _ in range(4)], "")
    said = command("pose", tmp_path / "in", tmp_path / "scene", *QUICKLY)
    assert said.code == 3
    assert "too little texture" in said.err
    assert "overlap" not in said.err
