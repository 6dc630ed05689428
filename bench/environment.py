"""Where numbers were measured: the commit, the versions, the folder for what is costly to make."""

import platform
import subprocess
from pathlib import Path

import torch
import warp as wp

CACHE = Path.home() / ".cache" / "graphgs-bench"


def commit() -> str:
    """The checkout's commit, or "unknown" outside a checkout."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def versions() -> dict[str, str]:
    return {"warp": wp.__version__, "torch": torch.__version__, "python": platform.python_version()}
