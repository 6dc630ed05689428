"""A COLMAP worker that dies at chosen work: `python -m tests.support.dying_worker`, for tests.

What it dies of is in the environment variable DYING_WORKER, as JSON: {"signal": 9, "pairs": [[0, 3]], "photos": [2],
"files": ["photos/000002.png"], "jobs": ["triangulate"], "once": "a file that is not there yet", "deaths": "a file that
gets a line per death"}. With `once` it leaves that file as it dies, and lives from then on.
"""

import json
import os
from pathlib import Path

from graphgs.structure import colmap_worker
from graphgs.structure.colmap import ColmapWorker

VARIABLE = "DYING_WORKER"


def dies_of(monkeypatch, tmp_path: Path, **what) -> None:
    """Workers die of this from here on."""
    monkeypatch.setattr(ColmapWorker, "program", "tests.support.dying_worker")
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).resolve().parents[2]))
    monkeypatch.setenv(VARIABLE, json.dumps({"deaths": str(tmp_path / "deaths.txt")} | what))


def deaths(tmp_path: Path) -> int:
    file = tmp_path / "deaths.txt"
    return len(file.read_text().splitlines()) if file.exists() else 0


def main() -> None:
    colmap_worker.serve(_mortal_jobs)


def _mortal_jobs() -> dict:
    what = json.loads(os.environ[VARIABLE])
    return {name: _mortal(name, job, what) for name, job in colmap_worker._colmap_jobs().items()}


def _mortal(name: str, job, what: dict):
    def run(**arguments):
        if name == "match" and ("pairs" in what or "photos" in what):
            _match_until_death(job, arguments, what)
        fatal_file = name == "extract" and set(arguments["images"]) & set(what.get("files", ()))
        if fatal_file or name in what.get("jobs", ()):
            _die(what)
        return job(**arguments)

    return run


def _match_until_death(job, arguments: dict, what: dict) -> None:
    """As native code would: the chunks before the fatal one are in the database."""
    chunk = arguments["chunk_pairs"]
    pairs = colmap_worker._colmap_jobs()["unmatched"](arguments["database"], arguments["pairs"], None)["pairs"]
    for first in range(0, len(pairs), chunk):
        part = pairs[first : first + chunk]
        if any(_fatal(pair, what) for pair in part):
            if first:
                job(**arguments | {"pairs": pairs[:first]})
            _die(what)


def _fatal(pair: list[int], what: dict) -> bool:
    return list(pair) in what.get("pairs", ()) or bool(set(pair) & set(what.get("photos", ())))


def _die(what: dict) -> None:
    once = what.get("once")
    if once and Path(once).exists():
        return
    if once:
        Path(once).touch()
    with open(what["deaths"], "a") as file:
        file.write("x\n")
    os.kill(os.getpid(), what["signal"])


if __name__ == "__main__":
    main()
