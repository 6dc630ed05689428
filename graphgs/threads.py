"""How many CPU threads GraphGS may use: one number, read wherever work is split."""

import os

_num_threads: int | None = None


def available_cpus() -> int:
    """CPUs this process may run on (its affinity mask where the platform has one)."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def set_num_threads(count: int) -> None:
    """Set the threads used by kernels and stages. Raises ValueError below 1."""
    global _num_threads
    if count < 1:
        raise ValueError(f"threads: expected at least 1, got {count}")
    _num_threads = count


def get_num_threads() -> int:
    """The number set by `set_num_threads`, else the CPUs this process may use."""
    return _num_threads if _num_threads is not None else available_cpus()
