"""Peak memory of a run, child processes included."""

import resource
import sys


def peak_rss_bytes() -> int:
    """An upper bound: this process's peak plus the largest child's (they need not have come at the same time)."""
    unit = 1 if sys.platform == "darwin" else 1024
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    child = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    return (own + child) * unit
