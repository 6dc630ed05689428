"""A recorded launch takes the arguments of each call, and arrays over foreign memory are whole."""

import numpy as np
import pytest
import warp as wp

from graphgs.kernels.arrays import carve, packed_size, view
from graphgs.kernels.launch import launch
from tests.kernels.fast_launch_kernels import Shift, add_scaled, add_vector


def test_each_call_has_its_own_arguments(device):
    for count, scale, by in ((5, 2.0, 1), (9, -1.0, 4), (5, 0.5, 0)):
        shift = Shift()
        shift.by = by
        values = wp.array(np.arange(count), dtype=float, device=device)
        out = wp.zeros(count, dtype=float, device=device)
        launch(add_scaled, count, inputs=[values, scale, shift, count > 5], outputs=[out], device=device)
        assert np.array_equal(out.numpy(), np.arange(count) * scale + by + (100 if count > 5 else 0))


def test_arguments_that_cannot_be_exchanged_are_taken_too(device):
    out = wp.zeros(3, dtype=wp.vec3, device=device)
    for value in (1.0, 2.0):
        launch(add_vector, 3, inputs=[wp.vec3(value)], outputs=[out], device=device)
    assert np.array_equal(out.numpy(), np.full((3, 3), 3.0))


def test_nothing_is_launched_for_no_threads(device):
    launch(add_vector, 0, inputs=[wp.vec3(1.0)], outputs=[wp.zeros(1, dtype=wp.vec3, device=device)], device=device)


@pytest.mark.parametrize("shape", [(12,), (3, 4), (2, 3, 2)])
def test_a_view_is_the_array_that_warp_would_make(device, shape):
    block = wp.array(np.arange(36), dtype=float, device=device)
    got = view(block.ptr, wp.vec3, shape, block.device, block)
    want = wp.array(ptr=block.ptr, dtype=wp.vec3, shape=shape, device=device)
    assert np.array_equal(got.numpy(), want.numpy())
    for name in ("shape", "strides", "size", "capacity", "ndim", "dtype", "device", "is_contiguous"):
        assert getattr(got, name) == getattr(want, name), name
    for name in ("data", "grad", "ndim"):
        assert getattr(got.__ctype__(), name) == getattr(want.__ctype__(), name), name
    for name in ("shape", "strides"):
        assert list(getattr(got.__ctype__(), name)) == list(getattr(want.__ctype__(), name)), name


def test_carved_arrays_do_not_overlap(device):
    wanted = (int, 5), (wp.vec3, 0), (wp.vec3, 70), (float, 1)
    block = wp.empty(packed_size(*wanted), dtype=wp.uint8, device=device)
    arrays = carve(block, block, *wanted)
    for k, array in enumerate(arrays):
        array.fill_(k)
    for k, (array, (_, size)) in enumerate(zip(arrays, wanted, strict=True)):
        assert array.size == size
        assert (array.numpy() == k).all()
