"""python -m bench [--only NAME] [--gate] [--update-baseline]: medians with the device, the versions and the commit."""

import argparse
import platform
import subprocess
import sys
from pathlib import Path

import torch
import warp as wp

from bench import rasterize
from bench.baselines import device_name, load_baseline, update_baseline
from bench.metrics import Metric

WORKLOADS = {"rasterize": rasterize.run}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m bench", description="Time the parts of GraphGS.")
    parser.add_argument("--only", choices=sorted(WORKLOADS), help="run this workload alone")
    parser.add_argument("--gate", action="store_true", help="exit 1 if a metric is worse than its baseline allows")
    parser.add_argument("--update-baseline", action="store_true", help="store the results for this device")
    args = parser.parse_args()

    device = device_name()
    environment = {"commit": commit(), "warp": wp.__version__, "torch": torch.__version__}
    print(device)
    print(", ".join(f"{k} {v}" for k, v in {"python": platform.python_version(), **environment}.items()))
    metrics = [m for name, run in WORKLOADS.items() if args.only in (None, name) for m in run()]

    baseline = load_baseline(device)
    for metric in metrics:
        print(line(metric, baseline.get(metric.name)))
    if args.update_baseline:
        print(f"wrote {update_baseline(device, metrics, environment)}")
    regressed = [m.name for m in metrics if m.name in baseline and m.regressed(baseline[m.name])]
    if regressed:
        print(f"worse than the baseline allows: {', '.join(regressed)}")
    elif args.gate and not baseline:
        print("no baseline for this device: nothing to compare with (--update-baseline makes one)")
    return 1 if args.gate and regressed else 0


def line(metric: Metric, baseline: float | None) -> str:
    text = f"{metric.name:44} {metric.value:10.2f} {metric.unit:3}"
    if baseline is None:
        return text
    word = "worse" if metric.change(baseline) > 0 else "better"
    return f"{text}  baseline {baseline:10.2f}  {abs(metric.change(baseline)):6.1%} {word}"


def commit() -> str:
    """The checkout's commit, or "unknown" outside a checkout."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


if __name__ == "__main__":
    sys.exit(main())
