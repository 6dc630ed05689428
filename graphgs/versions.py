"""Which versions are at work: for reports, run.toml and `graphgs --version`. Light: nothing heavy is imported."""

import platform
from importlib.metadata import PackageNotFoundError, version

import graphgs

PACKAGES = ("torch", "warp-lang", "taichi", "pycolmap", "numpy", "scipy", "opencv-python-headless")


def installed_versions() -> dict[str, str]:
    """Python, GraphGS itself and the packages it works with."""
    found = {"python": platform.python_version(), "graphgs": graphgs.__version__}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed as a package"
    return found


def version_line() -> str:
    """e.g. graphgs 0.1.0 (python 3.11.2, torch 2.13.0, ...)."""
    found = installed_versions()
    own = found.pop("graphgs")
    return f"graphgs {own} ({', '.join(f'{name} {number}' for name, number in found.items())})"
