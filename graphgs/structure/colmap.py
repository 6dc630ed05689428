"""The client of the COLMAP worker: starts it, sends jobs, relays progress, makes its death an error with a cause.

Jobs leave their results in files, whole or not at all, so a job that a signal ended can be given to a new process: it
is, once, with less at a time. What ends that one too is raised, as `WorkerDied`.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import graphgs
from graphgs.errors import DiskError, GraphGSError, OutOfMemoryError

_SMALLER_CHUNKS = 8  # times


class WorkerDied(GraphGSError):
    """A signal ended the process during a job: a fault of native code (SIGSEGV, SIGABRT)."""

    def __init__(self, message: str, *, hint: str, by: str):
        super().__init__(message, hint=hint)
        self.by = by  # the signal's name


class WorkerKilled(WorkerDied, OutOfMemoryError):
    """SIGKILL did: as a rule, the system was out of memory."""


class ColmapWorker:
    """A running worker. Use as a context manager: leaving the block ends the process, also on an exception."""

    program = "graphgs.structure.colmap_worker"  # a module that answers requests as that one does
    title = "COLMAP"

    def __init__(self, scratch: Path):
        scratch.mkdir(parents=True, exist_ok=True)
        self.peak_rss_mb = 0.0
        self._log = scratch / f"{self.title.lower()}.log"
        self._start()

    def _start(self) -> None:
        package_root = str(Path(graphgs.__file__).resolve().parents[1])
        path = os.pathsep.join(filter(None, [package_root, os.environ.get("PYTHONPATH")]))
        with open(self._log, "ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", self.program],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env={**os.environ, "PYTHONPATH": path},
                start_new_session=True,  # Ctrl-C reaches this process alone, which then ends the worker
            )

    @property
    def pid(self) -> int:
        return self._process.pid

    def __enter__(self) -> "ColmapWorker":
        return self

    def __exit__(self, *exception) -> None:
        self._end()

    def _end(self) -> None:
        self._process.kill()
        self._process.wait()
        with contextlib.suppress(BrokenPipeError):  # a job that the worker died before reading is flushed once more
            self._process.stdin.close()
        self._process.stdout.close()

    def run(self, job: str, *, progress: Callable[[int, int], None] | None = None, tries: int = 2, **arguments) -> dict:
        """Run one job of `colmap_jobs` and return its result. If a signal ends the worker, the job is run once more by
        another one, on one thread and in smaller chunks. Raises GraphGSError when it fails, WorkerDied when the last of
        `tries` workers is ended too; then `restart` gives another."""
        arguments = {k: str(v) if isinstance(v, Path) else v for k, v in arguments.items()}
        try:
            return self._run(job, progress, arguments)
        except WorkerDied as death:
            if tries == 1:
                raise
            self.restart(because=death.message)
        return self._run(job, progress, arguments | _gentler(arguments))

    def restart(self, *, because: str) -> None:
        """Another process in place of one that has ended."""
        self._end()
        with open(self._log, "a") as log:
            log.write(f"{because}; starting again\n")
        self._start()

    def _run(self, job: str, progress: Callable[[int, int], None] | None, arguments: dict) -> dict:
        try:
            self._process.stdin.write(json.dumps({"job": job, "arguments": arguments}) + "\n")
            self._process.stdin.flush()
        except OSError:
            raise self._death(job) from None
        for line in self._process.stdout:
            if not line.endswith("\n"):  # cut short by its death
                break
            message = json.loads(line)
            if "progress" in message:
                if progress is not None:
                    progress(*message["progress"])
            elif "failed" in message:
                raise self._failure(job, message["failed"])
            else:
                self.peak_rss_mb = max(self.peak_rss_mb, message["peak_rss_mb"])
                return message["result"]
        raise self._death(job)

    def _death(self, job: str) -> GraphGSError:
        code = self._process.wait()
        if code >= 0:
            return self._failure(job, f"exit code {code}: {self._last_words()}")
        name = signal.Signals(-code).name
        less = "lower structure.fine_max_side or structure.fine_features"
        if code == -signal.SIGKILL:
            return WorkerKilled(
                f"{self.title} was killed from outside during '{job}' ({name}), most likely because memory ran out",
                hint=f"two workers were; close other programs, or {less}; the same command continues where it stopped",
                by=name,
            )
        return WorkerDied(
            f"{self.title}'s '{job}' was ended by {name}: {self._last_words()}",
            hint=f"two workers were; {less}, which gives it less to do; the worker's log is {self._log}",
            by=name,
        )

    def _failure(self, job: str, cause: str) -> GraphGSError:
        if "disk is full" in cause or "No space left" in cause:
            return DiskError(
                f"{self.title}'s '{job}' ran out of disk space: {cause}", hint="free some space and run again"
            )
        return GraphGSError(
            f"{self.title}'s '{job}' failed: {cause}",
            hint=f"the worker's log is {self._log}; the same command continues where it stopped",
        )

    def _last_words(self) -> str:
        lines = [line for line in self._log.read_text(errors="replace").splitlines() if line.strip()]
        return " | ".join(lines[-3:]) or "it said nothing"


def _gentler(arguments: dict) -> dict:
    """The arguments that say how much is done at a time, with less: memory is what most often ends a worker."""
    less = {"threads": 1} if "threads" in arguments else {}
    if "chunk_pairs" in arguments:
        less["chunk_pairs"] = smaller_chunk(arguments["chunk_pairs"])
    return less


def smaller_chunk(chunk_pairs: int) -> int:
    """What a job that a signal ended is given when it is run once more."""
    return max(1, chunk_pairs // _SMALLER_CHUNKS)
