"""Launch the comparison of two images: sums of |a - b| and of SSIM over the kept values, and their gradients.

float32 on the CPU runs `rows.py`; everything else runs `pixels.py`. Sums are added in a fixed order, so the result does
not depend on the number of threads.
"""

from dataclasses import dataclass

import warp as wp

from graphgs.kernels.launch import launch_range
from graphgs.kernels.reduce import sum_rows, total
from graphgs.kernels.ssim.pixels import compare_pixels, compare_pixels_gradient
from graphgs.kernels.ssim.rows import compare_rows, compare_rows_gradient

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
    def shape_is_rows(self) -> bool:
        return self.a.device.is_cpu and self.a.dtype == wp.float32

    @property
    def rows(self) -> int:
        return self.a.shape[0] // (3 * self.width)

    def _inputs(self) -> list:
        return [self.a, self.b, self.kept, self.height, self.width]


def compare_images(
    images: ImagePair,
    slopes: wp.array,  # out, [3 C H W 3] for `compare_images_gradient`
    sums: wp.array,  # out, [2] float64: |a - b|, SSIM
    *,
    threads: int = 1,
) -> None:
    device = images.a.device
    row_sums = wp.empty(2 * images.rows, dtype=wp.float64, device=device)
    if images.shape_is_rows:
        launch_range(
            compare_rows,
            images.rows,
            inputs=images._inputs(),
            outputs=[slopes, row_sums],
            device=device,
            threads=threads,
            min_chunk=MIN_ROWS,
        )
    else:
        values = [wp.empty_like(images.a) for _ in range(2)]  # errors, similarities
        launch_range(
            compare_pixels,
            images.a.shape[0],
            inputs=images._inputs(),
            outputs=[slopes, *values],
            device=device,
            threads=threads,
            min_chunk=MIN_PIXELS,
        )
        for column, value in enumerate(values):
            part = row_sums[column * images.rows : (column + 1) * images.rows]
            sum_rows(value, part, width=3 * images.width, threads=threads)
    total(row_sums, sums)


def compare_images_gradient(
    images: ImagePair,  # the gradient is that of `a`
    slopes: wp.array,  # [3 C H W 3] from `compare_images`
    v_sums: wp.array,  # [2] gradient of the two sums
    v_a: wp.array,  # out, [C H W 3]
    *,
    threads: int = 1,
) -> None:
    """The gradient in `a`. For the one in `b`, exchange the images here and in `compare_images`."""
    by_rows = images.shape_is_rows
    launch_range(
        compare_rows_gradient if by_rows else compare_pixels_gradient,
        images.rows if by_rows else images.a.shape[0],
        inputs=[*images._inputs(), slopes, v_sums],
        outputs=[v_a],
        device=images.a.device,
        threads=threads,
        min_chunk=MIN_ROWS if by_rows else MIN_PIXELS,
    )
