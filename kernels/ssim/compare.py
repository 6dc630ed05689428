"""Launch the comparison of two images: sums of |a - b| and of SSIM over the kept values, and their gradients.

In float32 `rows.py` runs on the CPU and `blocks.py` on CUDA; in float64, anywhere, `pixels.py`. Sums are added in a
fixed order, so the result does not depend on the number of threads, nor change from run to run on a GPU.
"""

from dataclasses import dataclass
from typing import Literal

import warp as wp

from graphgs.kernels.launch import launch_blocks, launch_range
from graphgs.kernels.reduce import sum_rows, total
from graphgs.kernels.ssim.blocks import THREADS, TILE, compare_blocks, compare_blocks_gradient
from graphgs.kernels.ssim.pixels import compare_pixels, compare_pixels_gradient
from graphgs.kernels.ssim.rows import compare_rows, compare_rows_gradient

Shape = Literal["rows", "blocks", "pixels"]

MIN_ROWS = 8  # fewer are not worth a launch of their own
MIN_PIXELS = 4096


@dataclass(frozen=True)
class ImagePair:
    """Two batches of RGB images, [C, H, W, 3] flat, in one float type."""

    a: wp.array
    b: wp.array
    kept: wp.array  # 1 or 0 for every value; where it is 0, the caller has made a equal to b
    height: int
    width: int

    @property
    def shape(self) -> Shape:
        if self.a.dtype != wp.float32:
            return "pixels"
        return "rows" if self.a.device.is_cpu else "blocks"

    @property
    def rows(self) -> int:
        return self.a.shape[0] // (3 * self.width)

    @property
    def tile_grid(self) -> tuple[int, int]:
        """Rows of tiles in all images, tiles in a row."""
        return self.rows // self.height * -(-self.height // TILE), -(-self.width // TILE)

    def _inputs(self) -> list:
        return [self.a, self.b, self.kept, self.height, self.width]


def compare_images(
    images: ImagePair,
    slopes: wp.array,  # out, [3 C H W 3] for `compare_images_gradient`
    sums: wp.array,  # out, [2] float64: |a - b|, SSIM
    *,
    threads: int = 1,
    shape: Shape | None = None,  # default: what suits the type and the device
) -> None:
    compare = {"rows": _compare_rows, "blocks": _compare_blocks, "pixels": _compare_pixels}[shape or images.shape]
    total(compare(images, slopes, threads), sums)


def _compare_rows(images: ImagePair, slopes: wp.array, threads: int) -> wp.array:  # [2 C H] sums by image row
    row_sums = wp.empty(2 * images.rows, dtype=wp.float64, device=images.a.device)
    launch_range(
        compare_rows,
        images.rows,
        inputs=images._inputs(),
        outputs=[slopes, row_sums],
        device=images.a.device,
        threads=threads,
        min_chunk=MIN_ROWS,
    )
    return row_sums


def _compare_blocks(images: ImagePair, slopes: wp.array, threads: int) -> wp.array:  # [2 rows] sums by row of tiles
    rows, columns = images.tile_grid
    device = images.a.device
    tile_sums = wp.empty(2 * rows * columns, dtype=wp.float64, device=device)
    launch_blocks(
        compare_blocks,
        rows * columns,
        inputs=[*images._inputs(), columns],
        outputs=[slopes, tile_sums],
        device=device,
        block_dim=THREADS,
    )
    row_sums = wp.empty(2 * rows, dtype=wp.float64, device=device)
    sum_rows(tile_sums, row_sums, width=columns, threads=threads)
    return row_sums


def _compare_pixels(images: ImagePair, slopes: wp.array, threads: int) -> wp.array:  # [2 C H] sums by image row
    values = [wp.empty_like(images.a) for _ in range(2)]  # errors, similarities
    launch_range(
        compare_pixels,
        images.a.shape[0],
        inputs=images._inputs(),
        outputs=[slopes, *values],
        device=images.a.device,
        threads=threads,
        min_chunk=MIN_PIXELS,
    )
    row_sums = wp.empty(2 * images.rows, dtype=wp.float64, device=images.a.device)
    for column, value in enumerate(values):
        part = row_sums[column * images.rows : (column + 1) * images.rows]
        sum_rows(value, part, width=3 * images.width, threads=threads)
    return row_sums


def compare_images_gradient(
    images: ImagePair,  # the gradient is that of `a`
    slopes: wp.array,  # [3 C H W 3] from `compare_images`
    v_sums: wp.array,  # [2] gradient of the two sums
    v_a: wp.array,  # out, [C H W 3]
    *,
    threads: int = 1,
    shape: Shape | None = None,
) -> None:
    """The gradient in `a`. For the one in `b`, exchange the images here and in `compare_images`."""
    shape = shape or images.shape
    device = images.a.device
    if shape == "blocks":
        rows, columns = images.tile_grid
        launch_blocks(
            compare_blocks_gradient,
            rows * columns,
            inputs=[*images._inputs(), columns, slopes, v_sums],
            outputs=[v_a],
            device=device,
            block_dim=THREADS,
        )
        return
    by_rows = shape == "rows"
    launch_range(
        compare_rows_gradient if by_rows else compare_pixels_gradient,
        images.rows if by_rows else images.a.shape[0],
        inputs=[*images._inputs(), slopes, v_sums],
        outputs=[v_a],
        device=device,
        threads=threads,
        min_chunk=MIN_ROWS if by_rows else MIN_PIXELS,
    )
