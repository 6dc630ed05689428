"""`graphgs pose` on a photo set, one thread, in a process of its own; kept for as long as the code stays the same."""

import functools
import hashlib
import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import graphgs
import graphgs.kernels
from bench.child_process import run_module
from bench.shape_colmap import fingerprint
from bench.shape_sets import ShapeSet
from bench.shape_verdict import Status
from graphgs.errors import DataError
from graphgs.scene.colmap import find_model, read_model
from graphgs.scene.reconstruction import Reconstruction


@dataclass(frozen=True)
class OursResult:
    model: Reconstruction | None  # the cameras as photographed
    status: Status
    cautions: tuple[str, ...]
    message: str  # what a run that failed said
    cpu_s: float


def ours_result(cache: Path, found: ShapeSet) -> OursResult:
    folder = cache / "shape_ours" / code_version() / f"{found.name}_{fingerprint(found.images, found.photos)}"
    record = folder / "result.json"
    if not record.is_file():
        shutil.rmtree(folder, ignore_errors=True)
        scene, log = folder / "scene", folder / "log.txt"
        ended = run_module("graphgs", ["pose", str(found.images), str(scene), "--threads", "1"], log=log)
        shutil.rmtree(scene / "cache", ignore_errors=True)  # of many gigabytes all that is read again is the model
        shutil.rmtree(scene / "colmap" / "images", ignore_errors=True)
        written = scene / "metrics.json"
        metrics = json.loads(written.read_text()) if written.is_file() else {}
        said = {
            "status": status_of(ended.returncode, metrics),
            "cautions": metrics.get("cautions", []),
            "message": error_in(log.read_text(errors="replace")),
            "cpu_s": ended.cpu_s,
        }
        record.write_text(json.dumps(said, indent=1) + "\n")
    said = json.loads(record.read_text())
    original = folder / "scene" / "colmap" / "original"
    model = read_model(original) if find_model(original) else None
    return OursResult(model, said["status"], tuple(said["cautions"]), said["message"], said["cpu_s"])


def status_of(returncode: int, metrics: dict) -> Status:
    """One word for how a run ended."""
    if returncode == DataError.exit_code:
        return "partial" if metrics else "refused"
    if returncode != 0 or not metrics:
        return "failed"
    if metrics["status"] == "partial":
        return "partial"
    return "caution" if metrics["cautions"] else "ok"


def error_in(log: str) -> str:
    """The sentence a run failed with, "" if it did not."""
    return next((line.removeprefix("error: ") for line in log.splitlines() if line.startswith("error: ")), "")


@functools.cache
def code_version() -> str:
    """Of the package; once per run, whatever is edited meanwhile."""
    content = hashlib.sha256()
    for folder in (Path(graphgs.__file__).parent, Path(graphgs.kernels.__file__).parent):
        for path in sorted(folder.rglob("*.py")):
            content.update(path.read_bytes())
    return content.hexdigest()[:12]
