"""The child process that runs learned matching: `python -m graphgs.learned`, in the terms of `colmap_worker`."""

from collections.abc import Callable

from graphgs.structure.colmap_worker import serve


def _jobs() -> dict[str, Callable]:
    from graphgs.learned.xfeat import JOBS

    return JOBS


if __name__ == "__main__":
    serve(_jobs)
