"""Sixteen pixels at a time: C++ with Clang's vector types, shared by both passes of the CPU's rasterizer.

A tile of 16 x 16 pixels holds 16 blocks of 4 x 4; the pixels of a block are the lanes of one vector: one AVX-512
register, two of AVX2, four of NEON. Clang splits the type as the machine needs. The same loops in plain Warp are
correct, but whether LLVM vectorises them changes with the code around.

Splats of a tile are taken in batches of BATCH. A batch is turned round: each block gets the list of the splats that
meet it, as bits of one number, and walks that list with its pixels in registers.

The formulas are those of `pixels.py`; the tests hold the shapes together.
"""

import warp as wp

from graphgs.kernels.rasterize.constants import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN

BATCH = wp.constant(32)  # splats, a bit each
BLOCKS = wp.constant(16)  # of a tile

# A splat's record: mean, conic, log2 of the opacity, depth, ellipse, colours
LOG2_OPACITY, DEPTH, ELLIPSE, COLORS = (wp.constant(k) for k in (5, 6, 7, 12))


def record_size(channels: int) -> int:
    """Floats per record: whole cache lines."""
    return -(-(int(COLORS) + channels) // 16) * 16


def lanes(channels: int) -> str:
    """Types, constants and helpers, to stand at the beginning of a native function's body."""
    return f"""
    typedef float lanes __attribute__((ext_vector_type(16), aligned(4)));
    typedef int bits __attribute__((ext_vector_type(16), aligned(4)));
    constexpr int channels = {channels}, record_size = {record_size(channels)};
    constexpr int param_size = 6 + channels;  // of a splat, seen from its tile
    const lanes column = {{0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3}};
    const lanes row = {{0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3}};
    const lanes zero = 0.0f;
    constexpr float alpha_min = {float(ALPHA_MIN)!r}f, alpha_max = {float(ALPHA_MAX)!r}f;
    constexpr float light_min = {float(TRANSMITTANCE_MIN)!r}f;

    // 2^power, relative error below 3e-7: the whole part by the exponent's bits, which adding 1.5 * 2^23 leaves in the
    // lowest bits, the rest by a minimax polynomial on [-1/2, 1/2]
    auto power_of_two = [](lanes power) -> lanes {{
        power = power > -120.0f ? power : (lanes)-120.0f;
        const lanes shifted = power + 12582912.0f;
        const lanes f = power - (shifted - 12582912.0f);
        lanes p = 0.0013276471518561042f * f + 0.009675541330696702f;
        p = p * f + 0.05550713274964681f;
        p = p * f + 0.24022119723933463f;
        p = p * f + 0.693146967063862f;
        p = p * f + 1.000000071654657f;
        return (lanes)((bits)p + ((bits)shifted << 23));
    }};

    // What the loops over pixels read of a splat: offset to the tile's first pixel, log2 of alpha as a polynomial
    // p2 dx^2 + p3 dx dy + p4 dy^2 + p5 in the offset from the mean, colours, depth
    auto set_params = [](const float* s, float x, float y, float* p) {{
        constexpr float log2_e = 1.44269504f;
        p[0] = x - s[0];
        p[1] = y - s[1];
        p[2] = s[2] * (-0.5f * log2_e);
        p[3] = s[3] * -log2_e;
        p[4] = s[4] * (-0.5f * log2_e);
        p[5] = s[{int(LOG2_OPACITY)}];
        for (int c = 0; c < channels; ++c) p[6 + c] = s[{int(COLORS)} + c];
        p[6 + channels] = s[{int(DEPTH)}];
    }};
    """
