"""Whatever a person gives: one clear message saying what and what to do, the documented exit code, no traceback."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from graphgs import cli
from tests.support.pictures import picture, write_photos


@pytest.fixture
def said(capsys):
    """Call the command line with these arguments; returns (exit code, all it said)."""

    def call(*arguments) -> tuple[int, str]:
        try:
            code = cli._guarded([str(a) for a in arguments])
        except SystemExit as stopped:  # tyro's own errors
            code = stopped.code
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        assert "bug" not in err
        if code not in (0, None) and "helptext" not in err:  # tyro has its own form, we write two lines
            assert err.startswith("error: ")
            assert len(err.splitlines()) == 2
        return code, out + err

    return call


def noise(path: Path, seed: int) -> None:
    """A picture with many features, unlike that of any other seed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(seed).integers(0, 255, (60, 80, 3), dtype=np.uint8)
    Image.fromarray(pixels).resize((320, 240)).save(path)


def half_jpeg(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture(3, width=400, height=300)).save(path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])


def huge_png(path: Path, side: int = 60_000) -> None:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 99)) + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_photos(tmp_path, said, count):
    write_photos(tmp_path / "in", count)
    code, text = said("run", tmp_path / "in", tmp_path / "out")
    assert code == 3
    assert ("no photos" if count == 0 else f"fewer than 3 usable photos ({count})") in text


@pytest.mark.parametrize(
    ("write", "name", "reason"),
    [
        (lambda path: path.write_text("hello\n"), "text.jpg", "not an image"),
        (half_jpeg, "half.jpg", "cut short"),
        (huge_png, "huge.png", "200 megapixels"),
    ],
    ids=["text", "half", "huge"],
)
def test_an_unusable_file_is_named(tmp_path, said, write, name, reason):
    (tmp_path / "in").mkdir()
    write(tmp_path / "in" / name)
    code, text = said("run", tmp_path / "in", tmp_path / "out")
    assert code == 3
    assert name in text
    assert reason in text
    code, text = said("check", tmp_path / "in")  # looks at headers only
    assert code == 3
    assert "at least 3 are needed" in text


def test_photos_of_different_scenes_beside_broken_files(tmp_path, said):
    for i in range(4):
        noise(tmp_path / "in" / f"{i}.png", i)
    half_jpeg(tmp_path / "in" / "half.jpg")
    (tmp_path / "in" / "text.jpg").write_text("hello\n")
    code, text = said("run", tmp_path / "in", tmp_path / "out", "--threads", 1)
    assert code == 3
    assert "half.jpg: skipped" in text
    assert "text.jpg: skipped" in text
    assert "no two of the 4 photos show the same scene" in text


def test_identical_photos(tmp_path, said):
    for i in range(4):
        noise(tmp_path / "in" / f"{i}.png", 0)
    code, text = said("run", tmp_path / "in", tmp_path / "out", "--threads", 1)
    assert code == 3
    assert "different places" in text


@pytest.mark.parametrize("command", ["run", "pose", "check"])
def test_a_missing_folder(tmp_path, said, command):
    outputs = [] if command == "check" else [tmp_path / "out"]
    code, text = said(command, tmp_path / "nowhere", *outputs)
    assert code == 2
    assert "nowhere" in text
    assert "does not exist" in text
    assert not (tmp_path / "out").exists()


def test_outputs_that_cannot_be_written(tmp_path, said):
    write_photos(tmp_path / "in", 3)
    (tmp_path / "file").write_text("mine")
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        code, text = said("run", tmp_path / "in", place)
        assert code == 2
        assert str(place) in text
        assert "cannot write" in text
        code, text = said("synth", "street", place)
        assert code == 2
        assert str(place) in text
    assert (tmp_path / "file").read_text() == "mine"
    code, text = said("run", tmp_path / "in", tmp_path / "in")
    assert code == 2
    assert "the same" in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--frobnicate"], "--frobnicate"),
        (["--preset", "huge"], "preview"),
        (["--steps", "many"], "many"),
        (["--steps", "0"], "at least 1"),
        (["--threads", "0"], "--threads 0"),
        (["--max-side", "3"], "at least 32"),
        (["--device", "toaster"], "auto, cpu or cuda:0"),
        (["--device", "cuda:99"], "cuda:99"),
        (["--set", "training.steps"], "stage.field=value"),
        (["--set", "training.stepz=3"], "no setting 'stepz'"),
        (["--set", "train.steps=3"], "no stage 'train'"),
        (["--set", "training.steps=1.5"], "expected int"),
        (["--set", "training.ssim_weight=nan"], "expected float"),
        (["--set", "training.ssim_weight=2"], "0 to 1"),
        (["--set", "training.sampling=often"], "uniform"),
        (["--set", "points.fraction=0"], "above 0"),
        (["--config", "nowhere.toml"], "nowhere.toml"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_options(tmp_path, said, arguments, words):
    write_photos(tmp_path / "in", 3)
    code, text = said("run", tmp_path / "in", tmp_path / "out", *arguments)
    assert code == 2
    assert words in text
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [("steps = [", "not a TOML file"), ("steps = 3", "not a table"), ("[training]\nnope = 3", "no setting 'nope'")],
)
def test_a_bad_settings_file(tmp_path, said, text, words):
    write_photos(tmp_path / "in", 3)
    (tmp_path / "my.toml").write_text(text)
    code, answer = said("run", tmp_path / "in", tmp_path / "out", "--config", tmp_path / "my.toml")
    assert code == 2
    assert words in answer
    assert "my.toml" in answer


@pytest.mark.parametrize("command", ["train", "eval", "render"])
def test_an_empty_scene(tmp_path, said, command):
    (tmp_path / "scene").mkdir()
    outputs = [tmp_path / "pictures"] if command == "render" else []
    for scene in (tmp_path / "scene", tmp_path / "nowhere"):
        code, text = said(command, scene, *outputs)
        assert code == 2
        assert str(scene) in text
        assert "graphgs" in text


def test_names_cannot_write_to_the_terminal(tmp_path, said):
    code, text = said("run", tmp_path / "a\x1b[2Jb", tmp_path / "out")
    assert code == 2
    assert "\x1b" not in text
