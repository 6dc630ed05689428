"""Sums of vectors in a fixed order: the same bits for any number of threads."""

from functools import cache

import warp as wp

from graphgs.kernels.launch import launch_range

CHUNK = wp.constant(512)  # rows added up by one thread; fixed, so that the order never depends on the thread count


@cache
def sum_chunk_kernel(dtype):
    @wp.kernel(enable_backward=False, module="unique")
    def sum_chunk(
        first: int,
        rows: wp.array2d(dtype=dtype),  # [C, M]
        # Out
        sums: wp.array2d(dtype=dtype),  # [C, ceil(M / CHUNK)]
    ):
        thread = first + wp.tid()
        c = thread // sums.shape[1]
        chunk = thread % sums.shape[1]
        total = dtype()
        for i in range(chunk * CHUNK, wp.min((chunk + 1) * CHUNK, rows.shape[1])):
            total += rows[c, i]
        sums[c, chunk] = total

    return sum_chunk


def ordered_sum(
    rows: wp.array,  # [C, M] of vectors
    *,
    threads: int = 1,
) -> wp.array:  # [C, 1]
    """Sum over the second axis."""
    chunks = max(1, -(-rows.shape[1] // int(CHUNK)))
    sums = wp.empty((rows.shape[0], chunks), dtype=rows.dtype, device=rows.device)
    kernel = sum_chunk_kernel(rows.dtype)
    launch_range(kernel, sums.size, inputs=[rows], outputs=[sums], device=rows.device, threads=threads)
    return sums if chunks == 1 else ordered_sum(sums, threads=threads)
