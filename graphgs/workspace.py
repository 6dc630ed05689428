"""The output folder: artefacts under keys, atomic writes, one run at a time.

A stage's artefact lies in cache/NN_name/. It is written to cache/NN_name.partial/ and renamed when whole, so a folder
either is complete or is not there. Its key is a hash of the stage's name, version, settings and the keys of its inputs:
a changed setting reruns only what follows from it. cache/NN_name.scratch/ holds what a long stage needs to go on after
a kill, and is kept while the key stays the same.
"""

import errno
import hashlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from graphgs.errors import UsageError
from graphgs.progress import Reporter

Artefact = TypeVar("Artefact")

try:
    import fcntl
except ImportError:  # Windows: two runs in one folder are not kept apart there
    fcntl = None


@dataclass(frozen=True)
class Stage:
    """What the pipeline says of a stage: its place, its name, and the version of its meaning."""

    order: int
    name: str
    version: int  # raise it when the same settings and inputs give another artefact

    @property
    def folder(self) -> str:
        return f"{self.order:02d}_{self.name}"


@dataclass(frozen=True)
class Outcome(Generic[Artefact]):
    """An artefact with the key that later stages depend on."""

    artefact: Artefact
    key: str
    seconds: float  # spent making it, also in an earlier run
    reused: bool


@dataclass(frozen=True)
class Found:
    """A finished stage of an earlier run."""

    folder: Path
    key: str
    inputs: tuple[str, ...]  # keys of the artefacts it was made from
    seconds: float


class Workspace:
    """An output folder. Raises UsageError where it cannot be written or another run is at work in it."""

    def __init__(self, output: Path):
        self.output, self.cache = output, output / "cache"
        make_writable(output)
        make_writable(self.cache)
        self._lock = _lock(self.cache / "lock", output)

    def close(self) -> None:
        """Let another run have the folder."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def __enter__(self) -> "Workspace":
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def run(
        self,
        stage: Stage,
        *,
        settings: Any,  # plain data the artefact depends on
        inputs: list[str],  # keys of the artefacts it is made from
        produce: Callable[[Path, Path], Artefact],  # (folder, scratch) -> artefact; may write files into folder
        load: Callable[[Path], Artefact],
        reporter: Reporter,
        scratch: Path | None = None,  # a folder of its own for what survives a kill; it is kept afterwards
    ) -> Outcome[Artefact]:
        """The artefact from the cache if its key is unchanged, else made, saved and renamed into place.

        The artefact returned is always the one loaded from its final folder."""
        key = digest([stage.name, stage.version, settings, inputs])
        folder = self.cache / stage.folder
        record = _read_record(folder)
        if record is not None and record["key"] == key:
            reporter.event("stage", name=stage.name, key=key[:12], reused=True, seconds=record["seconds"])
            return Outcome(load(folder), key, record["seconds"], True)

        partial = self.cache / f"{stage.folder}.partial"
        work = _scratch(scratch or self.cache / f"{stage.folder}.scratch", key)
        _remove(partial)
        partial.mkdir()
        reporter.event("stage_begins", name=stage.name, key=key[:12])
        started = time.perf_counter()
        artefact = produce(partial, work)
        artefact.save(partial)
        seconds = round(time.perf_counter() - started, 3)
        write_json(partial / "stage.json", {"key": key, "inputs": inputs, "version": stage.version, "seconds": seconds})
        sync_tree(partial)
        _remove(folder)
        partial.rename(folder)
        sync_folder(self.cache)
        if scratch is None:
            _remove(work)
        reporter.event("stage", name=stage.name, key=key[:12], reused=False, seconds=seconds)
        return Outcome(load(folder), key, seconds, False)

    def find(self, stage: Stage) -> "Found | None":
        """A finished stage, whatever its key; None if there is none."""
        return find_stage(self.output, stage)


def find_stage(output: Path, stage: Stage) -> Found | None:
    """As Workspace.find, in a folder that is only read, while a run is at work in it or not. An artefact of another
    version of the stage has another form, and is as good as none."""
    folder = output / "cache" / stage.folder
    record = _read_record(folder)
    if record is None or record.get("version", stage.version) != stage.version:
        return None
    return Found(folder, record["key"], tuple(record["inputs"]), record["seconds"])


def make_writable(folder: Path) -> None:
    """Make the folder if it is not there. Raises UsageError where files cannot be written into it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise
        reason = "a file is in the way" if isinstance(error, (FileExistsError, NotADirectoryError)) else error.strerror
        raise UsageError(
            f"{folder}: cannot write there ({reason})", hint="choose an output folder you may write to"
        ) from error


def digest(value: Any) -> str:
    """Hash of plain data, independent of the order of dictionary keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()


def write_text(path: Path, text: str) -> None:
    """Write a file so that it is either the old one or the whole new one, also after a crash."""
    with atomic(path) as partial:
        partial.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any) -> None:
    write_text(path, json.dumps(value, indent=1) + "\n")


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """A file to write in place of `path`, renamed over it at the end; gone if writing fails."""
    partial = path.with_name(f".{path.name}.partial")
    try:
        yield partial
        _sync_file(partial)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def sync_tree(folder: Path) -> None:
    """Put every file below `folder` on the disk before the folder is renamed into place."""
    for path in folder.rglob("*"):
        if path.is_file():
            _sync_file(path)


def sync_folder(folder: Path) -> None:
    """Put a folder's entries (renames in it) on the disk, where the platform can."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sync_file(path: Path) -> None:
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def _read_record(folder: Path) -> dict | None:
    try:
        record = json.loads((folder / "stage.json").read_text())
    except (FileNotFoundError, NotADirectoryError, ValueError):  # ValueError: damaged
        return None
    return record if isinstance(record, dict) and {"key", "inputs", "seconds"} <= record.keys() else None


def _scratch(folder: Path, key: str) -> Path:
    """The folder emptied, unless what it holds belongs to the same key."""
    note = folder / "key"
    if not note.is_file() or note.read_text() != key:
        _remove(folder)
        folder.mkdir()
        write_text(note, key)
    return folder


def _remove(folder: Path) -> None:
    """Delete a folder; what says that it is whole goes first, as a kill may leave half of the rest."""
    if folder.is_dir():
        for mark in ("stage.json", "key"):
            (folder / mark).unlink(missing_ok=True)
        shutil.rmtree(folder)


def _lock(path: Path, output: Path):
    if fcntl is None:
        return None
    file = path.open("w")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        file.close()
        raise UsageError(
            f"{output}: another graphgs run is at work in this folder", hint="wait for it, or choose another output"
        ) from error
    return file
