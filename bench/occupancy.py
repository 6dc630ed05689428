"""Theoretical occupancy: the share of an SM's thread slots that blocks of a kernel can fill at once.

Limits: CUDA C++ Programming Guide, "Technical Specifications per Compute Capability", and for the units in which
registers and shared memory are given out, NVIDIA's occupancy calculator (`cuda_occupancy.h`).
"""

from dataclasses import dataclass

WARP = 32  # threads
REGISTERS = 65536  # of an SM, 32 bits each, on all these architectures
REGISTER_UNIT = 256  # registers are given to a warp in multiples of this
WARP_UNIT = 4  # an SM has four parts, each with registers of its own


@dataclass(frozen=True)
class Limits:
    """Of one SM."""

    blocks: int
    warps: int
    shared: int  # [B] for all its blocks
    shared_unit: int = 128  # [B]
    reserved: int = 1024  # [B] of shared memory per block, for the system


LIMITS = {
    75: Limits(blocks=16, warps=32, shared=64 * 1024, shared_unit=256, reserved=0),
    80: Limits(blocks=32, warps=64, shared=164 * 1024),
    86: Limits(blocks=16, warps=48, shared=100 * 1024),
    89: Limits(blocks=24, warps=48, shared=100 * 1024),
    90: Limits(blocks=32, warps=64, shared=228 * 1024),
    100: Limits(blocks=32, warps=64, shared=228 * 1024),
    120: Limits(blocks=24, warps=48, shared=100 * 1024),
}


def occupancy(
    architecture: int,  # 86 for sm_86
    *,
    registers: int,  # per thread
    shared: int,  # [B] per block, without what the system reserves
    threads: int,  # per block
) -> float:
    limits = LIMITS[architecture]
    warps = _round_up(threads, WARP) // WARP
    warp_registers = _round_up(registers * WARP, REGISTER_UNIT)
    register_warps = REGISTERS // warp_registers // WARP_UNIT * WARP_UNIT
    block_shared = _round_up(shared + limits.reserved, limits.shared_unit)
    blocks = min(limits.blocks, limits.warps // warps, register_warps // warps)
    if block_shared > 0:
        blocks = min(blocks, limits.shared // block_shared)
    return blocks * warps / limits.warps


def _round_up(value: int, unit: int) -> int:
    return -(-value // unit) * unit
