"""The child process that runs COLMAP: `python -m graphgs.structure.colmap_worker`.

One JSON object per line: {"job": name, "arguments": {...}} comes in; {"progress": [done, total]} any number of times
and one of {"result": {...}} or {"failed": message} go out. A native abort ends this process only; the client (`colmap`)
sees the end of the stream and says what happened. The end of the input, or of the parent, ends the worker.
"""

import ctypes
import json
import os
import resource
import signal
import sys
from collections.abc import Callable

import numpy  # noqa: F401  (before pycolmap, see colmap_jobs)

_PR_SET_PDEATHSIG = 1  # <linux/prctl.h>


def main() -> None:
    serve(_colmap_jobs)


def serve(load: Callable[[], dict[str, Callable]]) -> None:
    """Answer requests until the input ends, with the jobs that `load` returns; what it imports may print."""
    _die_with_parent()
    channel = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what native code prints goes to the log, never between two messages
    jobs = load()

    def send(**message) -> None:
        channel.write(json.dumps(message) + "\n")

    for line in sys.stdin:
        request = json.loads(line)
        try:
            result = jobs[request["job"]](**request["arguments"], progress=lambda d, t: send(progress=[d, t]))
        except Exception as error:
            send(failed=f"{type(error).__name__}: {error}")
        else:
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            send(result=result, peak_rss_mb=peak / (2**20 if sys.platform == "darwin" else 2**10))


def _colmap_jobs() -> dict[str, Callable]:
    from graphgs.structure.colmap_jobs import JOBS, pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    return JOBS


def _die_with_parent() -> None:
    """A parent killed with SIGKILL cannot end us, so ask the kernel to (Linux). Elsewhere the input's end does."""
    if not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() == 1:  # it died before the call
        os._exit(1)


if __name__ == "__main__":
    main()
