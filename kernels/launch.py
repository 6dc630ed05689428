"""Launch a Warp kernel on several CPU threads, or in blocks of GPU threads.

One CPU launch runs on one thread but releases Python's lock, so two threads that draw ranges work at once. A
kernel that wants this takes `first: int` as its FIRST argument and computes its index as `first + wp.tid()`. Each index
must write only memory of its own: then the result does not depend on the number of threads.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import warp as wp

_pools: dict[int, ThreadPoolExecutor] = {}


def _start_warp() -> None:
    """Initialise Warp without its banner, and without the line "could not find the CUDA driver", which its C++ part
    writes to file descriptor 2 on every machine that has no GPU and which no setting turns off."""
    wp.config.log_level = wp.LOG_WARNING  # no line per compiled module either
    try:
        terminal = os.dup(2)
    except OSError:  # no stderr to keep clean
        wp.init()
        return
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        wp.init()
    finally:
        os.dup2(terminal, 2)
        os.close(terminal)


_start_warp()

from graphgs.kernels.shared_range import SharedRange  # noqa: E402 - it makes a kernel, so Warp must have started


def launch_range(
    kernel: wp.Kernel,
    count: int,  # indices 0 .. count - 1
    *,
    inputs: Sequence,  # the kernel's arguments after `first`
    outputs: Sequence = (),
    device,
    threads: int = 1,
    min_chunk: int = 1,  # smallest range worth a launch of its own
    chunks_per_thread: int = 8,  # ranges are drawn from a queue, so uneven work balances
) -> None:
    """Run `kernel` for every index in [0, count). On CUDA this is one launch; `threads` matters on the CPU only."""
    if count <= 0:
        return
    alone = threads == 1 or count <= min_chunk or wp.config.enable_cpu_blocks  # blocks are for tests
    if alone or not wp.get_device(device).is_cpu:
        wp.launch(kernel, dim=count, inputs=[0, *inputs], outputs=list(outputs), device=device)
        return
    size = max(min_chunk, -(-count // (threads * chunks_per_thread)))
    shared = SharedRange(kernel, count, size, inputs=inputs, outputs=outputs)
    helpers = [_pool(threads - 1).submit(shared.run) for _ in range(threads - 1)]
    shared.run(wait=True)
    for helper in helpers:
        # All is done now. A helper that wakes up later finds nothing left, and is not waited for.
        if not helper.cancel() and helper.done():
            helper.result()


def launch_blocks(
    kernel: wp.Kernel,  # its `wp.tid()` is (block, thread)
    blocks: int,
    *,
    inputs: Sequence,
    outputs: Sequence = (),
    device,
    block_dim: int = 256,  # threads per block
) -> None:
    """Run `blocks` blocks of threads that share memory: the shape for a GPU.

    On the CPU such a kernel runs for tests, when `wp.config.enable_cpu_blocks` is set. Raises RuntimeError where it is
    not: Warp would run blocks of one thread, and return wrong numbers.
    """
    if wp.get_device(device).is_cpu and not wp.config.enable_cpu_blocks:
        raise RuntimeError(f"{kernel.key}: a kernel of blocks runs on the CPU under wp.config.enable_cpu_blocks only")
    wp.launch_tiled(
        kernel, dim=[blocks], inputs=list(inputs), outputs=list(outputs), block_dim=block_dim, device=device
    )


def _pool(workers: int) -> ThreadPoolExecutor:
    if workers not in _pools:
        _pools[workers] = ThreadPoolExecutor(workers, thread_name_prefix="warp-launch")
    return _pools[workers]
