"""One CPU launch drawn by several threads, without Python between its chunks.

Python costs more than the kernels here: a thread that needs the interpreter between two chunks waits for another to
let go of it, 0.1 ms at a time. So the arguments are packed once, and each thread makes a single call into a native loop
that draws chunks by an atomic counter until none is left.
"""

import ctypes
from collections.abc import Sequence
from functools import cache

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func_native(
    """
    typedef void (*kernel_t)(const void*, const void*);
    int* drawn = (int*)counters;
    int* done = drawn + 1;
    for (int chunk; (chunk = __atomic_fetch_add(drawn, 1, __ATOMIC_RELAXED)) < chunks;) {
        *(int*)args = chunk * size;  // the kernel's first argument
        ((kernel_t)kernel)((const void*)(chunk + 1 < chunks ? bounds : last_bounds), (const void*)args);
        __atomic_fetch_add(done, 1, __ATOMIC_RELEASE);
    }
    while (wait && __atomic_load_n(done, __ATOMIC_ACQUIRE) < chunks) {  // another thread is in its last chunk
    #if defined(__x86_64__) || defined(__i386__)
        __builtin_ia32_pause();
    #endif
    }
    """
)
def draw(
    kernel: wp.uint64,  # address of the compiled kernel
    bounds: wp.uint64,  # of a whole chunk
    last_bounds: wp.uint64,
    args: wp.uint64,  # this thread's own copy
    counters: wp.uint64,  # chunks drawn and chunks done, shared by all threads
    chunks: int,
    size: int,  # indices of a chunk
    wait: int,  # 1: until the others have done theirs
):
    """Run chunks of the kernel until none is left."""


@wp.kernel
def draw_chunks(
    kernel: wp.uint64,
    bounds: wp.uint64,
    last_bounds: wp.uint64,
    args: wp.uint64,
    counters: wp.uint64,
    chunks: int,
    size: int,
    wait: int,
):
    draw(kernel, bounds, last_bounds, args, counters, chunks, size, wait)


class SharedRange:
    """A launch of `kernel` over [0, count) in chunks of `size`; any number of threads may call `run` at once."""

    def __init__(self, kernel: wp.Kernel, count: int, size: int, *, inputs: Sequence, outputs: Sequence):
        command = wp.launch(
            kernel, dim=min(size, count), inputs=[0, *inputs], outputs=list(outputs), device="cpu", record_cmd=True
        )
        self._command = command  # keeps the arrays
        self._function = command.hooks.forward
        self._bounds, params = command.params[0], command.params[1:]
        self._chunks, self._size = -(-count // size), size
        command.set_dim(count - (self._chunks - 1) * size)
        self._last_bounds = command.params[0]
        self._args = _pack(params)
        self._counters = (ctypes.c_int32 * 2)(0, 0)
        _drawing()  # compiled here, before threads race for it

    def run(self, *, wait: bool = False) -> None:
        """Draw chunks until none is left, and `wait` until all are done. Python's lock is free meanwhile."""
        args = type(self._args).from_buffer_copy(self._args)
        function, bounds, draw_args = _drawing()
        mine = draw_args(
            ctypes.cast(self._function, ctypes.c_void_p).value,
            ctypes.addressof(self._bounds),
            ctypes.addressof(self._last_bounds),
            ctypes.addressof(args),
            ctypes.addressof(self._counters),
            self._chunks,
            self._size,
            int(wait),
        )
        function(ctypes.byref(bounds), ctypes.byref(mine))


def _pack(params: Sequence) -> ctypes.Structure:
    """A kernel's arguments one behind the other, as Warp passes them on the CPU."""
    packed = _structure(tuple(type(param) for param in params))()
    for k, param in enumerate(params):
        setattr(packed, f"p{k}", param)
    return packed


@cache
def _structure(types: tuple[type, ...]) -> type[ctypes.Structure]:
    return type("Args", (ctypes.Structure,), {"_fields_": [(f"p{k}", kind) for k, kind in enumerate(types)]})


@cache
def _drawing() -> tuple:
    """`draw_chunks`: its function, the bounds of one thread, the type of its arguments."""
    command = wp.launch(draw_chunks, dim=1, inputs=[0] * 8, device="cpu", record_cmd=True)
    types = tuple(type(param) for param in command.params[1:])
    return command.hooks.forward, command.params[0], _structure(types)
