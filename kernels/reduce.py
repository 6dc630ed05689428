"""Sums with a fixed order: one thread per row adds from left to right, then one thread adds the rows, in float64.

The result is the same for any number of threads, and from run to run on a GPU.
"""

from typing import Any

import warp as wp

from graphgs.kernels.launch import launch_range

wp.set_module_options({"enable_backward": False, "max_unroll": 0})


@wp.kernel
def sum_along_rows(
    first: int,
    values: wp.array[Any],  # [rows * width]
    width: int,
    # Out
    row_sums: wp.array[wp.float64],  # [rows]
):
    row = first + wp.tid()
    total = wp.float64(0.0)
    for x in range(width):
        total += wp.float64(values[row * width + x])
    row_sums[row] = total


@wp.kernel
def sum_in_order(
    first: int,
    row_sums: wp.array[wp.float64],  # [columns * rows]
    rows: int,
    # Out
    totals: wp.array[wp.float64],  # [columns]
):
    column = first + wp.tid()
    total = wp.float64(0.0)
    for row in range(rows):
        total += row_sums[column * rows + row]
    totals[column] = total


for _real in (wp.float32, wp.float64):
    wp.overload(sum_along_rows, [int, wp.array(dtype=_real, ndim=1), int, wp.array(dtype=wp.float64, ndim=1)])


def sum_rows(
    values: wp.array,  # [rows * width]
    row_sums: wp.array,  # out, [rows] float64
    *,
    width: int,
    threads: int = 1,
) -> None:
    launch_range(
        sum_along_rows,
        row_sums.shape[0],
        inputs=[values, width],
        outputs=[row_sums],
        device=values.device,
        threads=threads,
        min_chunk=64,
    )


def total(
    row_sums: wp.array,  # [columns * rows] float64
    totals: wp.array,  # out, [columns] float64
) -> None:
    columns = totals.shape[0]
    inputs = [0, row_sums, row_sums.shape[0] // columns]
    wp.launch(sum_in_order, dim=columns, inputs=inputs, outputs=[totals], device=row_sums.device)
