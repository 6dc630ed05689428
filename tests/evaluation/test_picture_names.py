"""Pictures of photos get names that stay in their folder and differ."""

import random
from pathlib import Path

import pytest

from graphgs.evaluation.picture_names import picture_names


def test_folders_stay_and_extensions_go():
    assert picture_names(("0001.jpg", "left/0001.jpg", "a.b.JPG")) == ("0001", "left/0001", "a.b")


def test_photos_that_differ_by_extension_or_case_keep_both():
    names = picture_names(("a.jpg", "a.png", "B.jpg", "b.JPG", "c.jpg"))
    assert names[:2] == ("a.jpg", "a.png")
    assert names[4] == "c"
    assert len({name.casefold() for name in names}) == 5


@pytest.mark.parametrize(
    "name",
    ["../../etc/passwd.jpg", "/etc/passwd.jpg", "..\\..\\x.jpg", "..", ".hidden.jpg", "a/./../b.jpg", "con.jpg"]
    + ["a:b*?.jpg", "x" * 400 + ".jpg", "猫" * 120 + ".jpg", " .jpg", "a\x00\nb.jpg", "\udcff.jpg"],
)
def test_odd_names_are_made_safe(name: str, tmp_path: Path):
    (safe,) = picture_names((name,))
    path = tmp_path / f"{safe}.truth.png"
    assert path.resolve().is_relative_to(tmp_path.resolve())
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"x")
    assert not any(part.startswith(".") or part.lower() in ("con", "..") for part in Path(safe).parts)


def test_names_are_unique_and_do_not_depend_on_the_order():
    names = ["a?.jpg", "a*.jpg", "a_.jpg", "A_.png", "d/x.jpg", "d/x.jpeg", "a.jpg", "a.png", "a.jpg.tif"]
    expected = dict(zip(names, picture_names(tuple(names)), strict=True))
    assert len({path.casefold() for path in expected.values()}) == len(names)
    random.Random(0).shuffle(names)
    assert dict(zip(names, picture_names(tuple(names)), strict=True)) == expected
