"""A command in a process of its own, and what it cost: processor seconds, those of its own children included."""

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent  # the checkout, from which `bench` and `graphgs` are imported
ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}


@dataclass(frozen=True)
class Ended:
    returncode: int  # negative: ended by that signal
    cpu_s: float


def run_module(module: str, arguments: Sequence[str], *, log: Path) -> Ended:
    """`python -m module arguments` on one thread, from this checkout; everything it prints goes to `log`."""
    environment = os.environ | ONE_THREAD | {"PYTHONPATH": str(ROOT)}
    log.parent.mkdir(parents=True, exist_ok=True)
    with open(log, "w") as output:
        child = subprocess.Popen(
            [sys.executable, "-m", module, *arguments], stdout=output, stderr=subprocess.STDOUT, env=environment
        )
        try:
            # wait4 alone tells one child's time, and that of the children which it waited for itself
            _, status, usage = os.wait4(child.pid, 0)
        except BaseException:
            child.terminate()
            raise
        child.returncode = os.waitstatus_to_exitcode(status)
    return Ended(child.returncode, usage.ru_utime + usage.ru_stime)
