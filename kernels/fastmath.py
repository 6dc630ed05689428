"""Elementary functions the CPU's vectoriser can keep in vector registers (it turns a call of `exp` into sixteen)."""

import platform

import warp as wp

LOG2_E = wp.constant(1.4426950408889634)


def vector_flags() -> str:
    """Compiler flags for a module of vectorised CPU loops.

    512-bit registers where there are any (LLVM stays at 256 by default), and a * b + c rounded once.
    """
    flags = "-march=native" if wp.config.cpu_compiler_flags is None else wp.config.cpu_compiler_flags
    flags += " -ffp-contract=fast"
    if platform.machine() in ("x86_64", "AMD64"):
        flags += " -mprefer-vector-width=512"
    return flags
