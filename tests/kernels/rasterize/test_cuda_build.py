"""The device-agnostic kernels compile for an RTX 3090 (sm_86), without a driver, and do not spill."""

import re
import subprocess
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import pytest
import warp as wp

from graphgs.kernels.rasterize import intersections, ordered_sum, pixels, project, shade

KERNELS = {
    "project_forward": project.project_forward_kernel(wp.float32),
    "project_backward": project.project_backward_kernel(wp.float32),
    "shade_forward": shade.shade_forward_kernel(wp.float32),
    "shade_backward": shade.shade_backward_kernel(wp.float32),
    "pixels_forward": pixels.pixels_forward_kernel(wp.float32, 3),
    "pixels_backward": pixels.pixels_backward_kernel(wp.float32, 3),
    "sum_chunk": ordered_sum.sum_chunk_kernel(wp.vec3),
    "count_tiles": intersections.count_tiles,
}


def cuobjdump() -> Path | None:
    try:
        installed = files("nvidia-cuda-cuobjdump") or []
    except PackageNotFoundError:
        return None
    return next((Path(f.locate()) for f in installed if f.name in ("cuobjdump", "cuobjdump.exe")), None)


@pytest.mark.parametrize("name", KERNELS)
def test_compiles_for_sm_86(name, tmp_path):
    wp.compile_aot_module(KERNELS[name].module, arch=86, module_dir=tmp_path)
    (cubin,) = tmp_path.glob("*.cubin")
    assert cubin.stat().st_size > 1000


@pytest.mark.parametrize(("name", "registers"), [("pixels_forward", 64), ("pixels_backward", 96)])
def test_keeps_its_state_in_registers(name, registers, tmp_path):
    tool = cuobjdump()
    if tool is None:
        pytest.skip("the wheel nvidia-cuda-cuobjdump is not installed")
    wp.compile_aot_module(KERNELS[name].module, arch=86, module_dir=tmp_path)
    (cubin,) = tmp_path.glob("*.cubin")
    text = subprocess.run([tool, "--dump-resource-usage", cubin], capture_output=True, text=True, check=True).stdout
    usage = dict(re.findall(r"(REG|STACK|LOCAL):(\d+)", text.split(f"Function {name}")[-1]))
    assert int(usage["STACK"]) == 0
    assert int(usage["LOCAL"]) == 0
    assert int(usage["REG"]) <= registers
