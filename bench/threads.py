"""How many threads a measurement may use."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

import graphgs
from graphgs.threads import get_num_threads

THREADS = (1, 2)


@contextmanager
def use_threads(count: int, *, torch_threads: int = 1) -> Iterator[None]:
    """Kernels on `count` threads; torch on one, as in training, where its sums must not depend on their number."""
    kernels, torches = get_num_threads(), torch.get_num_threads()
    graphgs.set_num_threads(count)
    torch.set_num_threads(torch_threads)
    try:
        yield
    finally:
        graphgs.set_num_threads(kernels)
        torch.set_num_threads(torches)


def counts(device: str) -> tuple[int, ...]:
    """What is worth comparing: a GPU has no such choice."""
    return THREADS if device == "cpu" else (1,)


def label(count: int) -> str:
    return f"{count} thread" + "s" * (count > 1)
