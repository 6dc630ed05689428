"""Warp arrays over memory that is already there, made in a few microseconds.

A small scene is rendered faster on a GPU than Python prepares its kernels' arguments, and Warp's own ways to an array
(`wp.from_torch`, `wp.empty`, a slice) take 10 to 30 us each; a step needs sixty. All that such an array holds but its
address and shape depends on its type and device alone, so that part is taken from a pattern that Warp made once.
"""

import ctypes
from functools import cache
from math import prod

import warp as wp


@cache
def _pattern(dtype: type, axes: int, device: str) -> tuple[dict, ctypes.Structure]:
    """Attributes of an array of one element, and its descriptor."""
    nowhere = ctypes.create_string_buffer(wp.types.type_size_in_bytes(dtype))
    array = wp.array(ptr=ctypes.addressof(nowhere), dtype=dtype, shape=(1,) * axes, device=device, copy=False)
    descriptor = array.__ctype__()
    return {**vars(array), "ctype": None}, descriptor


def view(
    address: int,
    dtype: type,
    shape: tuple[int, ...],
    device: wp.Device,
    owner,  # kept alive with the array
) -> wp.array:
    """A contiguous array at that address."""
    attributes, pattern = _pattern(dtype, len(shape), device.alias)
    descriptor = type(pattern).from_buffer_copy(pattern)
    descriptor.data = address
    size = prod(shape)
    if len(shape) == 1:
        strides = attributes["strides"]
        descriptor.shape[0] = size
    else:
        inner = attributes["strides"][-1]
        strides = tuple(inner * prod(shape[axis + 1 :]) for axis in range(len(shape)))
        for axis, stride in enumerate(strides):
            descriptor.shape[axis], descriptor.strides[axis] = shape[axis], stride
    array = wp.array.__new__(wp.array)
    array.__dict__ = {
        **attributes,
        "ptr": address,
        "shape": shape,
        "strides": strides,
        "size": size,
        "capacity": size * attributes["capacity"],
        "ctype": descriptor,
        "_ref": owner,
    }
    return array


def packed_size(*wanted: tuple[type, int]) -> int:
    """[B] that `carve` needs."""
    return sum(_aligned(dtype, size) for dtype, size in wanted)


def carve(block: wp.array, owner, *wanted: tuple[type, int]) -> list[wp.array]:
    """1-D arrays, given as (dtype, size), one behind the other in a block of memory; each keeps `owner` alive."""
    arrays, address = [], block.ptr
    for dtype, size in wanted:
        arrays.append(view(address, dtype, (size,), block.device, owner))
        address += _aligned(dtype, size)
    return arrays


def _aligned(dtype: type, size: int) -> int:
    """[B] of an array, with the gap that aligns the next as if it had been allocated by itself."""
    return -(-wp.types.type_size_in_bytes(dtype) * size // 256) * 256
