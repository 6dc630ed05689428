"""The wheel holds exactly the folders of the tree."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_package_list_equals_the_folders():
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    found = set()
    for top, package in (("graphgs", "graphgs"), ("kernels", "graphgs.kernels")):
        for init in (ROOT / top).rglob("__init__.py"):
            found.add(".".join([package, *init.parent.relative_to(ROOT / top).parts]))
    assert sorted(declared) == sorted(found)


def test_every_folder_with_code_is_a_package():
    for top in ("graphgs", "kernels"):
        for path in (ROOT / top).rglob("*.py"):
            assert (path.parent / "__init__.py").is_file(), path


def test_kernels_are_found_from_the_checkout():
    import graphgs.kernels.launch as launch

    assert Path(launch.__file__).name == "launch.py"
