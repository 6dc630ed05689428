"""Kernels for `test_fast_launch.py`: Warp wants them in a file of their own, without pytest's rewriting."""

import warp as wp


@wp.struct
class Shift:
    by: int


@wp.kernel
def add_scaled(values: wp.array[float], scale: float, shift: Shift, more: bool, out: wp.array[float]):
    i = wp.tid()
    out[i] = values[i] * scale + float(shift.by)
    if more:
        out[i] += 100.0


@wp.kernel
def add_vector(value: wp.vec3, out: wp.array[wp.vec3]):
    out[wp.tid()] += value
