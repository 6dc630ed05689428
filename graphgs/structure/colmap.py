"""The client of the COLMAP worker: starts it, sends jobs, relays progress, makes its death an error with a cause."""

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
        self._process.kill()
        self._process.wait()
        with contextlib.suppress(BrokenPipeError):  # a job that the worker died before reading is flushed once more
            self._process.stdin.close()
        self._process.stdout.close()

    def run(self, job: str, *, progress: Callable[[int, int], None] | None = None, **arguments) -> dict:
        """Run one job of `colmap_jobs` and return its result. Raises GraphGSError when it fails or the worker dies."""
        arguments = {k: str(v) if isinstance(v, Path) else v for k, v in arguments.items()}
        try:
            self._process.stdin.write(json.dumps({"job": job, "arguments": arguments}) + "\n")
            self._process.stdin.flush()
        except OSError:
            raise self._death(job) from None
        for line in self._process.stdout:
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
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        if code == -signal.SIGKILL:
            return OutOfMemoryError(
                f"{self.title} was killed from outside during '{job}' ({how}), most likely because memory ran out",
                hint="close other programs, or lower structure.fine_max_side or structure.fine_features; "
                "the same command continues where it stopped",
            )
        return self._failure(job, f"{how}: {self._last_words()}")

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
