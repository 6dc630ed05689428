"""The kernels that a GPU runs, in float32, and those of them that break a rule.

The rules are for a training step: a kernel keeps its state in registers (no stack, no spills), and its registers and
shared memory leave room for at least half the threads that an SM of sm_86 can hold. float64 is for tests, not for GPUs.
"""

from dataclasses import dataclass

import warp as wp

from graphgs.kernels import reduce
from graphgs.kernels.rasterize import (
    gpu_backward,
    gpu_forward,
    gpu_gather,
    gpu_lists,
    gpu_shade,
    intersections,
    ordered_sum,
    pixels,
    project,
    shade,
)
from graphgs.kernels.reproject import blocks as reproject_blocks
from graphgs.kernels.reproject import consistency
from graphgs.kernels.ssim import blocks as ssim_blocks

ARCHITECTURES = (75, 80, 86, 89, 90, 100, 120)
CHANNELS = 3


@dataclass(frozen=True)
class GpuKernel:
    kernel: wp.Kernel
    training_step: bool = True
    block_dim: int = 256  # threads


def _overload(kernel: wp.Kernel, real: type) -> wp.Kernel:
    """The version of a generic kernel whose first array holds `real`."""
    for version in kernel.overloads.values():
        if next(arg.type.dtype for arg in version.adj.args if hasattr(arg.type, "dtype")) is real:
            return version
    raise LookupError(f"{kernel.key}: no version for {real.__name__}")


KERNELS = {
    # rasterize
    "project_forward": GpuKernel(project.project_forward_kernel(wp.float32)),
    "project_backward": GpuKernel(project.project_backward_kernel(wp.float32)),
    "shade_forward": GpuKernel(shade.shade_forward_kernel(wp.float32)),
    "shade_backward": GpuKernel(shade.shade_backward_kernel(wp.float32)),
    "gpu_shade_backward": GpuKernel(gpu_shade.gpu_shade_backward),
    "write_depth_keys": GpuKernel(gpu_lists.write_depth_keys),
    "count_tiles": GpuKernel(gpu_lists.count_tiles),
    "emit_keys": GpuKernel(gpu_lists.emit_keys),
    "find_ranges": GpuKernel(gpu_lists.find_ranges),
    "gpu_forward": GpuKernel(gpu_forward.gpu_forward_kernel(CHANNELS)),
    "gpu_backward": GpuKernel(gpu_backward.gpu_backward_kernel(CHANNELS, False)),
    "gpu_backward_absolute": GpuKernel(gpu_backward.gpu_backward_kernel(CHANNELS, True)),
    "gather_splats": GpuKernel(gpu_gather.gather_splats_kernel(CHANNELS, False)),
    "sum_chunk": GpuKernel(ordered_sum.sum_chunk_kernel(wp.types.vector(16, wp.float32))),
    # losses
    "compare_blocks": GpuKernel(ssim_blocks.compare_blocks),
    "compare_blocks_gradient": GpuKernel(ssim_blocks.compare_blocks_gradient),
    "compare_reprojected_blocks": GpuKernel(reproject_blocks.compare_reprojected_blocks),
    "sum_along_rows": GpuKernel(_overload(reduce.sum_along_rows, wp.float64)),
    "sum_in_order": GpuKernel(reduce.sum_in_order),
    # not in a training step: the plain shape of compositing, and reprojection for its own sake
    "pixels_forward": GpuKernel(pixels.pixels_forward_kernel(wp.float32, CHANNELS), training_step=False),
    "pixels_backward": GpuKernel(pixels.pixels_backward_kernel(wp.float32, CHANNELS), training_step=False),
    "plain_count_tiles": GpuKernel(intersections.count_tiles, training_step=False),
    "plain_emit_keys": GpuKernel(intersections.emit_keys, training_step=False),
    "plain_find_ranges": GpuKernel(intersections.find_ranges, training_step=False),
    "reproject_pixels": GpuKernel(_overload(consistency.reproject_pixels, wp.float32), training_step=False),
}

# Exceptions, each with its reason; docs/kernels.md says more.
LOCAL_ARRAYS: dict[str, str] = {}  # the array that does not fit into registers
LOW_OCCUPANCY = {"project_backward": "128 registers: the adjoint of a whole projection is alive at once"}
