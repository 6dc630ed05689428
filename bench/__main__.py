"""python -m bench [--only NAME ...] [--device cuda:0] [--gate] [--update-baseline]

Medians with the device, the versions and the commit, and how they compare with the baseline of the same device.
"""

import argparse
import sys
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import torch
import warp as wp

import graphgs.kernels.launch  # noqa: F401 - starts Warp, without its banner
from bench.baselines import device_name, load_baseline, update_baseline
from bench.environment import CACHE, commit, versions
from bench.metrics import Metric


@dataclass(frozen=True)
class Workload:
    module: str  # in this package, imported when it runs; its `run(device)` returns metrics
    about: str
    cached: bool = False  # `run(device, cache)`: inputs too costly to make each time
    on_request: bool = False  # takes long: runs only when named
    same_everywhere: bool = False  # no timings: one baseline for all machines, per version of Warp
    options: bool = False  # its module declares further arguments; `run(device, cache, args)`


WORKLOADS = {
    "rasterize": Workload("rasterize", "rasterize, forward and backward"),
    "stages": Workload("stages", "the rasterizer's stages one by one"),
    "training": Workload("training", "one training step"),
    "memory": Workload("memory", "peak memory of rendering, and whether it grows"),
    "ssim": Workload("ssim", "photometric loss, forward and backward"),
    "reproject": Workload("reproject", "consistency loss, forward and backward"),
    "sweep": Workload("sweep", "planes swept through one photo"),
    "octree": Workload("octree", "pruning 300,000 points"),
    "structure": Workload("structure", "pairs, matching, mapping: 150 and 600 photos", cached=True, on_request=True),
    "structure-quick": Workload("structure_quick", "the same on 75 photos", cached=True, on_request=True),
    "structure-noise": Workload(
        "structure_noise", "pairs from noisy poses: 60 and 150 photos", cached=True, on_request=True
    ),
    "shape": Workload("shape", "the shape of reconstructions, ours beside COLMAP's", on_request=True, options=True),
    "gpu-static": Workload(
        "gpu_static", "what the compiler says about the GPU's kernels; needs no GPU", same_everywhere=True
    ),
    "quality": Workload("quality", "scenes learned with and without each part", on_request=True, options=True),
    "pairing": Workload("pairing", "choosing pairs for 600 to 100,000 cameras, and how well the gate tells"),
    "gate-2k": Workload("gate_2k", "how well the overlap gate tells on a street of 2000 photos", on_request=True),
    "pairing-1m": Workload("pairing_million", "choosing pairs for a million cameras", on_request=True),
}


def main() -> int:
    args = parse()
    if args.list:
        print("\n".join(f"{name:16} {workload.about}" for name, workload in WORKLOADS.items()))
        return 0
    device = device_name(args.device)
    environment = {"commit": commit(), **versions()}
    print(device)
    print(", ".join(f"{k} {v}" for k, v in environment.items()))
    environment.pop("python")

    regressed = []
    for name in args.only or [name for name, workload in WORKLOADS.items() if not workload.on_request]:
        workload = WORKLOADS[name]
        run = import_module(f"bench.{workload.module}").run
        inputs = (args.cache, args) if workload.options else (args.cache,) if workload.cached else ()
        metrics = run(args.device, *inputs)
        store = name if workload.same_everywhere else device
        baseline = load_baseline(store, metrics, warp=wp.__version__ if workload.same_everywhere else None)
        report(metrics, baseline, changes_only=workload.same_everywhere)
        regressed += [m.name for m in metrics if m.name in baseline and m.regressed(baseline[m.name])]
        if args.update_baseline:
            stored = {"warp": wp.__version__} if workload.same_everywhere else environment
            print(f"wrote {update_baseline(store, metrics, stored)}")
        elif args.gate and len(baseline) < len(metrics):
            missing = len(metrics) - len(baseline)
            print(f"{name}: {missing} of {len(metrics)} metrics have no baseline for {store} (--update-baseline)")
    if regressed:
        print(f"worse than the baseline allows: {', '.join(regressed)}")
    return 1 if args.gate and regressed else 0


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench", description="Time the parts of GraphGS.")
    parser.add_argument("--list", action="store_true", help="print the workloads and exit")
    parser.add_argument("--only", nargs="+", choices=WORKLOADS, metavar="NAME", help="run these workloads alone")
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0 (default: cpu)")
    parser.add_argument(
        "--cache", type=Path, default=CACHE, help=f"folder for rendered streets and their matches (default: {CACHE})"
    )
    parser.add_argument("--gate", action="store_true", help="exit 1 if a metric is worse than its baseline allows")
    parser.add_argument("--update-baseline", action="store_true", help="store the results for this device")
    words = [word for word in sys.argv[1:] if word not in ("-h", "--help")]  # help comes last, when it is complete
    named = parser.parse_known_args(words)[0].only or []
    with_options = [name for name in named if WORKLOADS[name].options]
    if len(with_options) > 1:
        parser.error(f"--only: {' and '.join(with_options)} have options of their own; run one after the other")
    for name in with_options:
        import_module(f"bench.{WORKLOADS[name].module}").add_arguments(parser)
    args = parser.parse_args()
    if args.device != "cpu" and not (wp.is_cuda_available() and torch.cuda.is_available()):
        parser.error(f"--device {args.device}: needs a CUDA device that both Warp and torch can use")
    return args


def report(metrics: list[Metric], baseline: dict[str, float], *, changes_only: bool) -> None:
    for metric in metrics:
        before = baseline.get(metric.name)
        if not changes_only or (before is not None and metric.change(before) != 0):
            print(line(metric, before))


def line(metric: Metric, baseline: float | None) -> str:
    text = f"{metric.name:44} {metric.value:10.2f} {metric.unit:3}"
    if baseline is None:
        return text
    word = "worse" if metric.change(baseline) > 0 else "better"
    return f"{text}  baseline {baseline:10.2f}  {abs(metric.change(baseline)):6.1%} {word}"


if __name__ == "__main__":
    sys.exit(main())
