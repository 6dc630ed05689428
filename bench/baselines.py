"""Committed results, one JSON file per device: {"device": ..., "metrics": {name: {"value", "unit"}}}."""

import json
import os
import platform
import re
from collections.abc import Sequence
from pathlib import Path

from bench.metrics import Metric

FOLDER = Path(__file__).parent / "baselines"


def device_name() -> str:
    """The processor and how many CPUs this process may use: what a timing depends on."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        found = re.search(r"^model name\s*:\s*(.+)$", cpuinfo.read_text(), re.MULTILINE)
        model = found.group(1) if found else model
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{model.strip()}, {count} CPUs"


def _path(device: str) -> Path:
    return FOLDER / (re.sub(r"[^a-z0-9]+", "-", device.lower()).strip("-") + ".json")


def load_baseline(device: str) -> dict[str, float]:
    """Values by metric name; empty for a device without a baseline."""
    path = _path(device)
    if not path.is_file():
        return {}
    return {name: entry["value"] for name, entry in json.loads(path.read_text())["metrics"].items()}


def update_baseline(device: str, metrics: Sequence[Metric], environment: dict[str, str]) -> Path:
    """Write these metrics; those of workloads that did not run stay as they are."""
    path = _path(device)
    stored = json.loads(path.read_text())["metrics"] if path.is_file() else {}
    stored |= {m.name: {"value": round(m.value, 3), "unit": m.unit, **environment} for m in metrics}
    FOLDER.mkdir(exist_ok=True)
    path.write_text(json.dumps({"device": device, "metrics": dict(sorted(stored.items()))}, indent=1) + "\n")
    return path
