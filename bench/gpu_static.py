"""What the compiler says about the kernels of a GPU: registers, stack, spills, shared memory, and the occupancy that
follows. It needs no GPU, and no time is measured: the same version of Warp gives the same numbers everywhere.
"""

import json
import re
import subprocess
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import warp as wp

from bench.gpu_kernels import ARCHITECTURES, KERNELS, GpuKernel
from bench.metrics import Metric
from bench.occupancy import LIMITS, occupancy

COMPILERS = 2  # modules compiled at a time


@dataclass(frozen=True)
class Usage:
    """Of one kernel on one architecture."""

    registers: int  # per thread
    stack: int  # [B] per thread: arrays and spills
    local: int  # [B] per thread: static local memory
    shared: int  # [B] per block, without what the system reserves
    threads: int  # per block
    occupancy: float  # theoretical, 0..1


def run(device: str) -> list[Metric]:
    tool = cuobjdump()
    if tool is None:
        raise SystemExit('gpu-static needs cuobjdump: pip install "graphgs[test]"')
    usages = compile_all(tool)
    print(f"{'kernel':28}    sm  regs  stack  local  shared  threads  occupancy")
    for (name, architecture), use in usages.items():
        print(
            f"{name:28} {architecture:5} {use.registers:5} {use.stack:6} {use.local:6} {use.shared:7} {use.threads:8}"
            f" {use.occupancy:10.0%}"
        )
    return [m for (name, architecture), use in usages.items() for m in _metrics(f"{name}/sm_{architecture}", use)]


def _metrics(prefix: str, use: Usage) -> list[Metric]:
    return [
        Metric(f"{prefix}/registers", use.registers, "", "lower", 0.1),
        Metric(f"{prefix}/stack", use.stack, "B", "lower", 0),
        Metric(f"{prefix}/local", use.local, "B", "lower", 0),
        Metric(f"{prefix}/occupancy", round(100 * use.occupancy, 1), "%", "higher", 0),
    ]


def cuobjdump() -> Path | None:
    """The tool from NVIDIA's wheel, if that is installed."""
    try:
        installed = files("nvidia-cuda-cuobjdump") or []
    except PackageNotFoundError:
        return None
    return next((Path(f.locate()) for f in installed if f.name in ("cuobjdump", "cuobjdump.exe")), None)


def compile_all(
    tool: Path,
    kernels: dict[str, GpuKernel] = KERNELS,
    architectures: Sequence[int] = ARCHITECTURES,
) -> dict[tuple[str, int], Usage]:
    """By kernel and architecture. Warp keeps what it has compiled, so a second call takes no time."""
    modules = list({id(entry.kernel.module): entry.kernel.module for entry in kernels.values()}.values())

    def resources(module: wp.Module) -> list[dict[str, dict[str, int]]]:
        binaries = wp.compile_aot_module(module, arch=architectures, use_ptx=False)
        return [_resources(tool, binary) for binary in binaries]

    with ThreadPoolExecutor(COMPILERS) as pool:
        found = dict(zip(map(id, modules), pool.map(resources, modules), strict=True))
    usages = {}
    for name, entry in kernels.items():
        for architecture, functions in zip(architectures, found[id(entry.kernel.module)], strict=True):
            symbol = f"{entry.kernel.get_mangled_name()}_cuda_kernel"
            usages[name, architecture] = _usage(functions[f"{symbol}_forward"], entry.block_dim, architecture)
            if f"{symbol}_backward" in functions:  # the adjoint that Warp derives
                adjoint = _usage(functions[f"{symbol}_backward"], entry.block_dim, architecture)
                usages[f"{name}'", architecture] = adjoint
    return usages


def _resources(tool: Path, binary: Path) -> dict[str, dict[str, int]]:
    """By function: what cuobjdump prints, and the bytes of shared memory that Warp asks for at launch."""
    command = [tool, "--dump-resource-usage", binary]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    at_launch = json.loads((binary.parent / f"{binary.name.split('.sm')[0]}.meta").read_text())
    return {
        function: {key: int(value) for key, value in re.findall(r"(REG|STACK|LOCAL|SHARED):(\d+)", numbers)}
        | {"LAUNCH": at_launch[f"{function}_smem_bytes"]}
        for function, numbers in re.findall(r"Function (\S+):\s+(.*)", text)
    }


def _usage(resources: dict[str, int], threads: int, architecture: int) -> Usage:
    reserved = LIMITS[architecture].reserved if architecture >= 90 else 0  # which cuobjdump counts from sm_90 on
    shared = resources["SHARED"] - reserved + resources["LAUNCH"]
    return Usage(
        registers=resources["REG"],
        stack=resources["STACK"],
        local=resources["LOCAL"],
        shared=shared,
        threads=threads,
        occupancy=occupancy(architecture, registers=resources["REG"], shared=shared, threads=threads),
    )
