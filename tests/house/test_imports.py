"""Imports point one way, and the heavy or dangerous ones stay where they belong."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# Left to right: a room may import itself and what stands before it.
ROOMS = [
    *("kernels", "errors", "threads", "progress", "memory", "scene", "sources", "structure", "graph", "points"),
    *("learned", "rendering", "losses", "evaluation", "training", "export", "synth", "options", "config"),
    *(
        "workspace",
        "console",
        "versions",
        "stages",
        "explain",
        "forecast",
        "pipeline",
        "outputs",
        "api",
        "commands",
        "cli",
    ),
]
MODULES = [path for top in ("kernels", "graphgs") for path in sorted((ROOT / top).rglob("*.py"))]


def _imports(path: Path) -> list[str]:
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def _room(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return parts[0] if parts[0] == "kernels" else parts[1]


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_point_one_way(path: Path):
    room = _room(path)
    if room in ("__init__", "__main__"):
        return
    assert room in ROOMS, f"{room}: a new room needs a place in the order"
    allowed = set(ROOMS[: ROOMS.index(room) + 1]) | {"__version__", "kernels", "get_num_threads", "set_num_threads"}
    for name in _imports(path):
        head, *rest = name.split(".")
        assert head not in ("tests", "bench", "kernels"), f"{path.name} imports {name}"
        if head == "graphgs" and rest:
            assert rest[0] in allowed, f"{path.name} ({room}) imports {name}, which stands to its right"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_dangerous_imports_stay_in_their_rooms(path: Path):
    heads = {name.split(".")[0] for name in _imports(path)}
    room = _room(path)
    if room == "kernels":
        assert not heads & {"torch", "cv2", "pycolmap", "json", "logging", "pathlib", "graphgs.scene"}, heads
        third_party = heads - set(sys.stdlib_module_names) - {"graphgs"}
        assert third_party <= {"warp", "taichi", "numpy"}, third_party
    if room in ("scene", "sources", "structure", "graph", "points"):
        assert "torch" not in heads
    if "pycolmap" in heads:
        assert path.parent == ROOT / "graphgs/structure/colmap_jobs", "pycolmap has one room, run in a child process"


def test_pycolmap_is_not_loaded_by_the_package():
    """It corrupts the heap beside other libraries: only the child process may load it."""
    code = "import sys, graphgs.pipeline, graphgs.cli; sys.exit('pycolmap' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
