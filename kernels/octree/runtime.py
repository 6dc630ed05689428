"""The one place that starts Taichi: a second `ti.init` would kill every field that exists."""

import taichi as ti

_started = False


def ensure_started(threads: int) -> None:
    """Start Taichi on the CPU, once per process; the number of threads is that of the first call."""
    global _started
    if not _started:
        ti.init(arch=ti.cpu, log_level=ti.ERROR, offline_cache=True, cpu_max_num_threads=threads)
        _started = True
