"""A user's own pairs: how the file is read, and that they reach the candidates unfiltered."""

from types import SimpleNamespace

import numpy as np
import pytest

from graphgs import pipeline
from graphgs.config import Config
from graphgs.errors import UsageError
from graphgs.structure.extra_pairs import read_extra_pairs

NAMES = ("a.jpg", "b.jpg", "left/c d.jpg", "ü.jpg", "#1.jpg")


def _read(tmp_path, text: str) -> list[list[int]]:
    file = tmp_path / "pairs.txt"
    file.write_text(text, encoding="utf-8")
    return read_extra_pairs(file, NAMES).tolist()


def test_without_a_file_there_are_none():
    assert read_extra_pairs(None, NAMES).shape == (0, 2)


def test_lines_comments_quotes_and_order(tmp_path):
    text = """\ufeff# loop closures
    b.jpg a.jpg  # backwards

    a.jpg\tb.jpg
    "left/c d.jpg" ü.jpg
    a.jpg "#1.jpg"
    """
    assert _read(tmp_path, text) == [[0, 1], [0, 4], [2, 3]]
    assert _read(tmp_path, "# nothing\n\n") == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a.jpg b.jpg\na.jpg x.jpg\n", "line 2: there is no photo 'x.jpg'"),
        ("a.jpg\n", "line 1: expected two photo names, got 1"),
        ("\n\na.jpg b.jpg ü.jpg\n", "line 3: expected two photo names, got 3"),
        ("left/c d.jpg a.jpg", "line 1: expected two photo names, got 3"),
        ("b.jpg b.jpg", "line 1: 'b.jpg' is paired with itself"),
        ('"a.jpg b.jpg', "line 1: there is no photo '\"a.jpg'"),
    ],
)
def test_a_bad_line_is_named(tmp_path, text, message):
    with pytest.raises(UsageError) as caught:
        _read(tmp_path, text)
    assert message in str(caught.value)
    assert caught.value.hint


def test_a_file_that_cannot_be_read(tmp_path):
    with pytest.raises(UsageError, match="cannot be read"):
        read_extra_pairs(tmp_path / "missing.txt", NAMES)
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(UsageError, match="not a text file"):
        read_extra_pairs(tmp_path / "binary", NAMES)
    assert np.array_equal(read_extra_pairs(None, ()), np.zeros((0, 2)))


def test_what_the_file_says_is_in_the_stages_key(tmp_path):
    """Not where it lies, nor its comments."""

    def key(file, text: str) -> tuple:
        file.write_text(text, encoding="utf-8")
        config, keys = Config().replace("pairing", extra_file=str(file)), {}

        def stage(stage, inputs, produce, load, *, source_key="", **_):
            keys[stage] = source_key

        workspace = SimpleNamespace(cache=tmp_path)
        run = SimpleNamespace(config=config, reporter=None, threads=1, workspace=workspace, stage=stage)
        pipeline._matched(run, SimpleNamespace(names=NAMES))
        return keys[pipeline.PAIRS], pipeline.settings_of(pipeline.PAIRS, config)

    one = key(tmp_path / "pairs.txt", "a.jpg b.jpg")
    assert one == key(tmp_path / "other.txt", "# again\nb.jpg a.jpg")
    assert one != key(tmp_path / "pairs.txt", "a.jpg ü.jpg")
    assert one != key(tmp_path / "pairs.txt", "")
