"""Reproject the pixels of image i into image j and compare colours: one thread per pixel.

The derivatives in colour and depth of image i come out of the same pass; image j and the cameras have none. Colours are
compared in float32 on CUDA by `blocks.py`, which adds up the pixels of a block before they leave it.
"""

from dataclasses import dataclass
from typing import Any, Literal

import warp as wp

from graphgs.kernels.launch import launch_blocks, launch_range
from graphgs.kernels.reduce import sum_rows, total
from graphgs.kernels.reproject.blocks import THREADS, compare_reprojected_blocks
from graphgs.kernels.reproject.matching import compare_pixel, match_pixel

wp.set_module_options({"enable_backward": False})

Shape = Literal["pixels", "blocks"]

BLOCKS_PER_ROW = 64  # whose sums one thread adds up, before another adds up the rows
MIN_PIXELS = 4096  # fewer are not worth a launch of their own


@wp.kernel
def reproject_pixels(
    first: int,
    # Image i
    depth_i: wp.array[Any],  # [C Hi Wi]
    alpha_i: wp.array[Any],  # [C Hi Wi]
    height_i: int,
    width_i: int,
    # Image j
    depth_j: wp.array[Any],  # [C Hj Wj]
    height_j: int,
    width_j: int,
    # Cameras and thresholds
    pixel_map: wp.array[Any],  # [C 12]
    unit_depth: int,  # 1: the printed geometry, a ray of depth 1 and no masks but the image's bounds
    limits: wp.array[Any],  # [2] least alpha, depth tolerance
    # Out
    coords: wp.array[Any],  # [C Hi Wi 2] px in image j
    depths: wp.array[Any],  # [C Hi Wi] in camera j
    matched: wp.array[Any],  # [C Hi Wi] 1 or 0
):
    index = first + wp.tid()
    valid, qx, qy, z, _d_qx, _d_qy, _pair = match_pixel(
        index, depth_i, alpha_i, height_i, width_i, depth_j, height_j, width_j, pixel_map, unit_depth, limits
    )
    coords[2 * index] = qx
    coords[2 * index + 1] = qy
    depths[index] = z
    matched[index] = wp.where(valid, z.dtype(1.0), z.dtype(0.0))


@wp.kernel
def compare_reprojected(
    first: int,
    # Image i
    depth_i: wp.array[Any],  # [C Hi Wi]
    alpha_i: wp.array[Any],  # [C Hi Wi]
    height_i: int,
    width_i: int,
    # Image j
    depth_j: wp.array[Any],  # [C Hj Wj]
    height_j: int,
    width_j: int,
    # Cameras and thresholds
    pixel_map: wp.array[Any],  # [C 12]
    unit_depth: int,
    limits: wp.array[Any],  # [2] least alpha, depth tolerance
    # Colours
    image_i: wp.array[Any],  # [C Hi Wi 3]
    image_j: wp.array[Any],  # [C Hj Wj 3]
    # Out
    residuals: wp.array[Any],  # [C Hi Wi] summed over the channels, 0 where there is no match
    matched: wp.array[Any],  # [C Hi Wi] 1 or 0
    slopes_image: wp.array[Any],  # [C Hi Wi 3] derivative of the residual in the colours of image i
    slopes_depth: wp.array[Any],  # [C Hi Wi] and in its depth
):
    index = first + wp.tid()
    residual, match = compare_pixel(
        index,
        depth_i,
        alpha_i,
        height_i,
        width_i,
        depth_j,
        height_j,
        width_j,
        pixel_map,
        unit_depth,
        limits,
        image_i,
        image_j,
        slopes_image,
        slopes_depth,
    )
    residuals[index] = residual
    matched[index] = match


for _real in (wp.float32, wp.float64):
    _values = wp.array(dtype=_real, ndim=1)
    _common = [int, _values, _values, int, int, _values, int, int, _values, int, _values]
    wp.overload(reproject_pixels, [*_common, *[_values] * 3])
    wp.overload(compare_reprojected, [*_common, *[_values] * 6])


@dataclass(frozen=True)
class DepthPair:
    """C pairs of depth images and what leads from one to the other; every array flat, of one float type."""

    depth_i: wp.array  # [C Hi Wi]
    alpha_i: wp.array  # [C Hi Wi]
    size_i: tuple[int, int]  # height, width [px]
    depth_j: wp.array  # [C Hj Wj]
    size_j: tuple[int, int]
    pixel_map: wp.array  # [C 12], see geometry.py
    unit_depth: bool
    limits: wp.array  # [2] least alpha, depth tolerance

    @property
    def shape(self) -> Shape:
        return "blocks" if self.depth_i.device.is_cuda and self.depth_i.dtype == wp.float32 else "pixels"

    def _inputs(self) -> list:
        return [
            *(self.depth_i, self.alpha_i, *self.size_i),
            *(self.depth_j, *self.size_j),
            *(self.pixel_map, int(self.unit_depth), self.limits),
        ]


def reproject_depth(
    depths: DepthPair,
    coords: wp.array,  # out, [C Hi Wi 2] px in image j
    depths_j: wp.array,  # out, [C Hi Wi] in camera j
    matched: wp.array,  # out, [C Hi Wi] 1 or 0
    *,
    threads: int = 1,
) -> None:
    launch_range(
        reproject_pixels,
        depths.depth_i.shape[0],
        inputs=depths._inputs(),
        outputs=[coords, depths_j, matched],
        device=depths.depth_i.device,
        threads=threads,
        min_chunk=MIN_PIXELS,
    )


def compare_views(
    depths: DepthPair,
    image_i: wp.array,  # [C Hi Wi 3]
    image_j: wp.array,  # [C Hj Wj 3]
    slopes_image: wp.array,  # out, [C Hi Wi 3] derivative of the residual's sum in image_i
    slopes_depth: wp.array,  # out, [C Hi Wi] and in depth_i
    sums: wp.array,  # out, [2] float64: residuals over all channels, matched pixels
    *,
    threads: int = 1,
    shape: Shape | None = None,  # default: blocks in float32 on CUDA
) -> None:
    compare = _compare_blocks if (shape or depths.shape) == "blocks" else _compare_pixels
    inputs = [*depths._inputs(), image_i, image_j]
    total(compare(depths, inputs, [slopes_image, slopes_depth], threads), sums)


def _compare_pixels(depths: DepthPair, inputs: list, slopes: list, threads: int) -> wp.array:  # [2 C Hi] sums by row
    values = [wp.empty_like(depths.depth_i) for _ in range(2)]  # residuals, matched
    device = depths.depth_i.device
    launch_range(
        compare_reprojected,
        depths.depth_i.shape[0],
        inputs=inputs,
        outputs=[*values, *slopes],
        device=device,
        threads=threads,
        min_chunk=MIN_PIXELS,
    )
    width = depths.size_i[1]
    rows = depths.depth_i.shape[0] // width
    row_sums = wp.empty(2 * rows, dtype=wp.float64, device=device)
    for column, value in enumerate(values):
        sum_rows(value, row_sums[column * rows : (column + 1) * rows], width=width, threads=threads)
    return row_sums


def _compare_blocks(depths: DepthPair, inputs: list, slopes: list, threads: int) -> wp.array:  # [2 rows of blocks]
    device = depths.depth_i.device
    rows = -(-depths.depth_i.shape[0] // (THREADS * BLOCKS_PER_ROW))  # the last may hold blocks without pixels
    block_sums = wp.empty(2 * rows * BLOCKS_PER_ROW, dtype=wp.float64, device=device)
    launch_blocks(
        compare_reprojected_blocks,
        rows * BLOCKS_PER_ROW,
        inputs=inputs,
        outputs=[*slopes, block_sums],
        device=device,
        block_dim=THREADS,
    )
    row_sums = wp.empty(2 * rows, dtype=wp.float64, device=device)
    sum_rows(block_sums, row_sums, width=BLOCKS_PER_ROW, threads=threads)
    return row_sums
