"""A reader that has seen enough (`| head -1`) is no bug: whatever prints ends quietly, with a code of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from graphgs import cli
from graphgs.console import RunReporter
from tests.support.pictures import write_photos

ROOT = Path(__file__).resolve().parents[2]
WENT_AWAY = 141


def ended(arguments: list, *, errors_too: bool = False) -> tuple[int, str]:
    """(exit code, what was said on stderr) of a command whose reader goes away before it prints anything."""
    reading, writing = os.pipe()
    os.close(reading)
    process = subprocess.Popen(
        [sys.executable, "-m", "graphgs", *map(str, arguments)],
        stdout=writing,
        stderr=subprocess.STDOUT if errors_too else subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    os.close(writing)
    said = "" if errors_too else process.stderr.read()
    return process.wait(), said


@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["check", "{photos}"]], ids=lambda a: a[0])
def test_a_command_ends_quietly(tmp_path, arguments):
    write_photos(tmp_path / "photos", 4)
    assert ended([a.format(photos=tmp_path / "photos") for a in arguments]) == (WENT_AWAY, "")


@pytest.mark.parametrize("form", [[], ["--json"]], ids=["text", "json"])
def test_a_run_ends_quietly_in_the_middle(tmp_path, form):
    write_photos(tmp_path / "photos", 4)
    assert ended(["pose", tmp_path / "photos", tmp_path / "scene", "--threads", 1, *form]) == (WENT_AWAY, "")
    assert not (tmp_path / "scene" / "report.html").exists()


def test_an_error_that_nobody_reads_is_no_bug_either(tmp_path):
    assert ended(["check", tmp_path / "nowhere"], errors_too=True)[0] == WENT_AWAY


def test_progress_meets_the_closed_pipe_too():
    class Closed:
        encoding = "utf-8"

        def write(self, text):
            raise BrokenPipeError

        flush = write

    with pytest.raises(BrokenPipeError):
        RunReporter(stream=Closed()).stage(1, 2, "Reading")


def test_the_version_names_what_is_at_work(capsys):
    assert cli._guarded(["--version"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("graphgs ")
    for name in ("python", "torch", "pycolmap", "warp-lang"):
        assert f"{name} " in line
