"""Torch tensors seen as Warp arrays, without a copy."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import cache

import numpy as np
import torch
import warp as wp
from torch import Tensor

from graphgs.kernels.arrays import view
from graphgs.kernels.rasterize.ordered_sum import ordered_sum
from graphgs.threads import get_num_threads

_REAL = {torch.float32: wp.float32, torch.float64: wp.float64}
_SCALARS = {**_REAL, torch.int32: wp.int32, torch.uint8: wp.uint8}


def real_type(tensor: Tensor) -> type:
    """Warp's scalar type for a float32 or float64 tensor."""
    return _REAL[tensor.dtype]


def vectors(
    tensor: Tensor,  # [..., D], contiguous
    *,
    axes: int = 1,  # of the array that comes out; the leading axes of the tensor are flattened into its first
) -> wp.array:  # of vectors of D numbers
    *shape, length = tensor.shape
    if axes == 1:
        size = tensor.numel() // length
        return _view(tensor, _vector(length, tensor.dtype), (size,))
    split = len(shape) - axes + 1
    return _view(tensor, _vector(length, tensor.dtype), (tensor.shape[:split].numel(), *shape[split:]))


def scalars(tensor: Tensor) -> wp.array:  # [...] contiguous -> 1-D
    return _view(tensor, _SCALARS[tensor.dtype], (tensor.numel(),))


def matrices(tensor: Tensor) -> wp.array:  # [C, 4, 4] contiguous -> [C] of mat44
    return _view(tensor, _matrix(tuple(tensor.shape[-2:]), tensor.dtype), (tensor.shape[0],))


flags = scalars  # [...] uint8


def _view(tensor: Tensor, dtype: type, shape: tuple[int, ...]) -> wp.array:
    if not tensor.is_contiguous():
        raise ValueError(f"expected a contiguous tensor, got strides {tensor.stride()} of {list(tensor.shape)}")
    # Not the tensor itself: its graph would live as long as the array.
    return view(tensor.data_ptr(), dtype, shape, _device(tensor.device), tensor.detach())


@cache
def _vector(length: int, dtype: torch.dtype) -> type:
    return wp.types.vector(length, _SCALARS[dtype])


@cache
def _matrix(shape: tuple[int, int], dtype: torch.dtype) -> type:
    return wp.types.matrix(shape, _SCALARS[dtype])


_device = cache(wp.device_from_torch)


def zeros(shape: tuple[int, ...], like: Tensor) -> Tensor:
    """`like.new_zeros(shape)`, on one thread. On the CPU torch wakes its thread pool for anything large, and pool
    threads spin for milliseconds afterwards, on the cores that the next kernel wants."""
    if like.device.type != "cpu":
        return like.new_zeros(shape)
    return torch.from_numpy(np.zeros(shape, dtype=np.float64 if like.dtype == torch.float64 else np.float32))


def sum_rows(
    rows: Tensor,  # [C, M, D]
) -> Tensor:  # [C, D]
    """Sum over M in an order that does not depend on the number of threads, which torch's sum does not promise."""
    with torch_stream(rows.device):
        return wp.to_torch(ordered_sum(vectors(rows.contiguous(), axes=2), threads=get_num_threads())).squeeze(1)


@contextmanager
def torch_stream(device: torch.device) -> Iterator[None]:
    """Launch on torch's current stream, so that no synchronisation is needed. On the CPU this does nothing.

    As `wp.ScopedStream`, but a stream is wrapped once, and waits for Warp's own stream the first time alone.
    """
    if device.type == "cpu":
        yield
        return
    with torch.cuda.device(device) if device.index != torch.cuda.current_device() else nullcontext():
        ours = _device(device)
        before, stream = ours.stream, torch.cuda.current_stream(device).cuda_stream
        if before.cuda_stream == stream:
            yield
            return
        known = _streams.get((ours.alias, stream))
        wrapped = _streams[ours.alias, stream] = known or wp.Stream(ours, cuda_stream=stream)
        ours.set_stream(wrapped, sync=known is None)
        try:
            yield
        finally:
            ours.set_stream(before, sync=False)


_streams: dict[tuple[str, int], wp.Stream] = {}
