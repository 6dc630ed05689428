"""Torch tensors seen as Warp arrays, without a copy."""

from contextlib import AbstractContextManager, nullcontext

import numpy as np
import torch
import warp as wp
from torch import Tensor

from graphgs.kernels.rasterize.ordered_sum import ordered_sum
from graphgs.threads import get_num_threads

_REAL = {torch.float32: wp.float32, torch.float64: wp.float64}


def real_type(tensor: Tensor) -> type:
    """Warp's scalar type for a float32 or float64 tensor."""
    return _REAL[tensor.dtype]


def vectors(
    tensor: Tensor,  # [..., D], contiguous
    *,
    axes: int = 1,  # of the array that comes out; the leading axes of the tensor are flattened into its first
) -> wp.array:  # of vectors of D numbers
    kind = wp.int32 if tensor.dtype == torch.int32 else real_type(tensor)
    split = tensor.dim() - axes
    flat = tensor.detach().reshape(tensor.shape[:split].numel(), *tensor.shape[split:])
    return wp.from_torch(flat, dtype=wp.types.vector(tensor.shape[-1], kind))


def scalars(tensor: Tensor) -> wp.array:  # [...] contiguous -> 1-D
    return wp.from_torch(tensor.detach().reshape(-1), dtype=real_type(tensor))


def matrices(tensor: Tensor) -> wp.array:  # [C, 4, 4] contiguous -> [C] of mat44
    return wp.from_torch(tensor.detach(), dtype=wp.types.matrix(tuple(tensor.shape[-2:]), real_type(tensor)))


def flags(tensor: Tensor) -> wp.array:  # [...] uint8, contiguous -> 1-D
    return wp.from_torch(tensor.reshape(-1), dtype=wp.uint8)


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


def torch_stream(device: torch.device) -> AbstractContextManager:
    """Launch on torch's current stream, so that no synchronisation is needed. On the CPU this does nothing."""
    if device.type != "cuda":
        return nullcontext()
    return wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(device)))
