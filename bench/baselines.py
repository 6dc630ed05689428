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
    metrics: Sequence[Metric],
    *,
    warp: str | None = None,  # leave out what another version of Warp was measured with
) -> dict[str, float]:
    """Values by metric name, of those that may be compared; a ratio to another yardstick may not."""
    stored = _stored(device)
    return {
        m.name: stored[m.name]["value"]
        for m in metrics
        if m.name in stored
        and stored[m.name].get("yardstick", "") == m.yardstick
        and warp in (None, stored[m.name]["warp"])
    }


def update_baseline(device: str, metrics: Sequence[Metric], environment: dict[str, str]) -> Path:
    """Write these metrics; those of workloads that did not run stay as they are."""
    stored = _stored(device) | {m.name: _entry(m) | environment for m in metrics}
    # a line per metric, so that a diff reads like the table
    lines = (f"  {json.dumps(name)}: {json.dumps(stored[name])}" for name in sorted(stored))
    path = baseline_path(device)
    path.parent.mkdir(exist_ok=True)
    path.write_text(f'{{"device": {json.dumps(device)}, "metrics": {{\n' + ",\n".join(lines) + "\n}}\n")
    return path


def _entry(metric: Metric) -> dict:
    entry = {"value": round(metric.value, 3), "unit": metric.unit}
    return entry | ({"yardstick": metric.yardstick} if metric.yardstick else {})


def _stored(device: str) -> dict[str, dict]:
    path = baseline_path(device)
    return json.loads(path.read_text())["metrics"] if path.is_file() else {}
