"""Launch a Warp kernel on several CPU threads, or in blocks of GPU threads.

One CPU launch runs on one thread but releases Python's lock, so two threads that draw ranges work at once. A
kernel that wants this takes `first: int` as its FIRST argument and computes its index as `first + wp.tid()`. Each index
must write only memory of its own: then the result does not depend on the number of threads.
"""

import ctypes
import os
import threading
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

_NUMBERS = (int, float, bool)
_recorded = threading.local()  # a launch that is being prepared belongs to one thread


class _Command:
    """A recorded launch of one kernel on one device. Warp checks and converts its arguments once; afterwards they are
    only exchanged, which takes a few microseconds where `wp.launch` takes up to a hundred."""

    def __init__(self, kernel: wp.Kernel, dim: tuple[int, ...], args: list, device, block_dim: int) -> None:
        self.launch = wp.launch(kernel, dim=dim, inputs=args, device=device, block_dim=block_dim, record_cmd=True)
        self.launch.fwd_args = None  # else the first arguments live for ever
        self.dim = dim
        self.has_descriptor = [hasattr(arg, "__ctype__") for arg in args]  # arrays and structs; the others are numbers

    def run(self, dim: tuple[int, ...], args: list) -> None:
        launch = self.launch
        if dim != self.dim:
            launch.set_dim(dim)
            self.dim = dim
        params, addresses = launch.params, launch.params_addr
        for k, (arg, has_descriptor) in enumerate(zip(args, self.has_descriptor, strict=True), start=1):
            if has_descriptor:
                params[k] = descriptor = arg.__ctype__()
                if addresses is not None:  # CUDA
                    addresses[k] = ctypes.addressof(descriptor)
            else:
                params[k].value = arg
        launch.launch()


def launch(
    kernel: wp.Kernel,
    dim: int | tuple[int, ...],
    *,
    inputs: Sequence,
    outputs: Sequence = (),
    device,
    block_dim: int = 0,  # threads per block; 0: Warp's choice
) -> None:
    """`wp.launch`, faster from the second time on where arguments are arrays, structs and numbers: their types are not
    looked at again."""
    dim = dim if isinstance(dim, tuple) else (dim,)
    if 0 in dim:
        return
    device, args = wp.get_device(device), [*inputs, *outputs]
    key = (kernel, device.alias, block_dim, device.is_cpu and wp.config.enable_cpu_blocks)
    commands = vars(_recorded)
    command = commands.get(key)
    if command is None:
        plain = not kernel.is_generic and all(hasattr(arg, "__ctype__") or type(arg) in _NUMBERS for arg in args)
        command = commands[key] = _Command(kernel, dim, args, device, block_dim) if plain else False
    if command:
        command.run(dim, args)
    else:
        wp.launch(kernel, dim, inputs=args, device=device, block_dim=block_dim)


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
        launch(kernel, count, inputs=[0, *inputs], outputs=outputs, device=device)
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
    launch(kernel, (blocks, block_dim), inputs=inputs, outputs=outputs, device=device, block_dim=block_dim)


def _pool(workers: int) -> ThreadPoolExecutor:
    if workers not in _pools:
        _pools[workers] = ThreadPoolExecutor(workers, thread_name_prefix="warp-launch")
    return _pools[workers]
