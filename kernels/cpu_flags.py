"""Compiler options of a module whose CPU loops are vectorised."""

import platform

import warp as wp


def vector_flags() -> str:
    """512-bit registers where there are any (LLVM stays at 256 by default), and a * b + c rounded once."""
    flags = "-march=native" if wp.config.cpu_compiler_flags is None else wp.config.cpu_compiler_flags
    flags += " -ffp-contract=fast"
    if platform.machine() in ("x86_64", "AMD64"):
        flags += " -mprefer-vector-width=512"
    return flags


VECTOR_OPTIONS = {"enable_backward": False, "max_unroll": 0, "cpu_compiler_flags": vector_flags()}
