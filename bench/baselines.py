"""Committed results, one JSON file per device: {"device": ..., "metrics": {name: {"value", "unit", versions}}}."""

import json
import os
import platform
import re
from collections.abc import Sequence
from pathlib import Path

import warp as wp

from bench.metrics import Metric

FOLDER = Path(__file__).parent / "baselines"


def device_name(device: str = "cpu") -> str:
    """What a timing depends on: the GPU, or the processor and how many CPUs this process may use."""
    if device != "cpu":
        return wp.get_device(device).name
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        found = re.search(r"^model name\s*:\s*(.+)$", cpuinfo.read_text(), re.MULTILINE)
        model = found.group(1) if found else model
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{model.strip()}, {count} CPUs"


def baseline_path(device: str) -> Path:
    return FOLDER / (re.sub(r"[^a-z0-9]+", "-", device.lower()).strip("-") + ".json")


def load_baseline(
    device: str,
    *,
    warp: str | None = None,  # leave out what another version of Warp was measured with
) -> dict[str, float]:
    """Values by metric name; empty for a device without a baseline."""
    stored = _stored(device)
    return {name: entry["value"] for name, entry in stored.items() if warp in (None, entry["warp"])}


def update_baseline(device: str, metrics: Sequence[Metric], environment: dict[str, str]) -> Path:
    """Write these metrics; those of workloads that did not run stay as they are."""
    stored = _stored(device) | {m.name: {"value": round(m.value, 3), "unit": m.unit, **environment} for m in metrics}
    # a line per metric, so that a diff reads like the table
    lines = (f"  {json.dumps(name)}: {json.dumps(stored[name])}" for name in sorted(stored))
    path = baseline_path(device)
    path.parent.mkdir(exist_ok=True)
    path.write_text(f'{{"device": {json.dumps(device)}, "metrics": {{\n' + ",\n".join(lines) + "\n}}\n")
    return path


def _stored(device: str) -> dict[str, dict]:
    path = baseline_path(device)
    return json.loads(path.read_text())["metrics"] if path.is_file() else {}
