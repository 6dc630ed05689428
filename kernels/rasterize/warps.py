"""Programs for the 32 threads of a warp: C++ shared by both passes of the GPU's shape.

A tile of 16 x 16 pixels is shared by the 8 warps of a block; each owns 8 x 4 of its pixels, one per lane. Splats come
in batches through shared memory. Lane k first asks of splat k whether its ellipse alpha >= ALPHA_MIN meets the warp's
pixels; the answers are the bits of one number, and the warp walks those alone.

On CUDA a thread runs one lane. On the CPU, where tests run, one fiber of a block runs the 32 lanes of its warp in turn
(`lanes` is 32): what one lane keeps for itself is an array over lanes, of length 1 on CUDA, so in registers. A loop
over lanes ends where lanes meet: `ballot`, `sync_warp`. What the CPU therefore cannot show is a missing `sync_warp`
between lanes that hand each other values through shared memory, or a missing WP_TILE_SYNC between warps that do: at
both, the code says who writes and who reads.
"""

from graphgs.kernels.rasterize.constants import ALPHA_MAX, ALPHA_MIN, TILE_SIZE, TRANSMITTANCE_MIN

THREADS = 256  # of a block: one per pixel of a tile
COLORS = 7  # where the colours begin in a record: mean, exponent's three factors, opacity, depth, colours


def warps(channels: int, batch: int) -> str:
    """Constants, shared memory and helpers, to stand at the beginning of a native function's body.

    The function must have: thread, left and top [px] of the tile, means2d, conics, depths, opacities, colors,
    splat_ids.
    """
    assert TILE_SIZE == 16
    stride = -(-(COLORS + channels) // 4) * 4  # whole vectors of four
    return f"""
    constexpr int channels = {channels}, batch = {batch}, stride = {stride};
    constexpr float alpha_min = {float(ALPHA_MIN)!r}f, alpha_max = {float(ALPHA_MAX)!r}f;
    constexpr float light_min = {float(TRANSMITTANCE_MIN)!r}f;
    {_LANES}
    {_RECORDS}
    """


_LANES = """
#if defined(__CUDA_ARCH__)
    #define WARP_SHARED __shared__
    constexpr int lanes = 1;  // that this thread runs
    const int first_lane = thread & 31;
    constexpr bool runs = true;
#else
    #define WARP_SHARED static
    constexpr int lanes = 32;
    constexpr int first_lane = 0;
    const bool runs = (thread & 31) == 0;
#endif
    const int warp = thread >> 5;
    const int block_left = left + (warp & 1) * 8, block_top = top + (warp >> 1) * 4;  // [px] of the warp's pixels

    // A bit per lane, from numbers in which each lane has set its own
    auto ballot = [](unsigned bits) -> unsigned {
    #if defined(__CUDA_ARCH__)
        return __ballot_sync(0xffffffffu, bits != 0u);
    #else
        return bits;
    #endif
    };
    auto sync_warp = []() {
    #if defined(__CUDA_ARCH__)
        __syncwarp();
    #endif
    };
    auto lowest = [](unsigned bits) -> int {
    #if defined(__CUDA_ARCH__)
        return __ffs((int)bits) - 1;
    #else
        return __builtin_ctz(bits);
    #endif
    };
    auto power_of_two = [](float power) -> float {  // relative error below 2e-7 on CUDA
    #if defined(__CUDA_ARCH__)
        float result;
        asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(result) : "f"(power));
        return result;
    #else
        return wp::exp(power * 0.693147181f);
    #endif
    };
    auto multiply_add = [](float a, float b, float c) -> float {
    #if defined(__CUDA_ARCH__)
        return __fmaf_rn(a, b, c);
    #else
        return a * b + c;
    #endif
    };
    auto divide = [](float a, float b) -> float {
    #if defined(__CUDA_ARCH__)
        return __fdividef(a, b);
    #else
        return a / b;
    #endif
    };
    auto root = [](float square) -> float {
    #if defined(__CUDA_ARCH__)
        float result;
        asm("sqrt.approx.ftz.f32 %0, %1;" : "=f"(result) : "f"(square));
        return result;
    #else
        return wp::sqrt(square);
    #endif
    };
"""

_RECORDS = """
    constexpr int outline = 7;  // mean, then the ellipse as in ellipse.py; an odd length: 32 lanes, 32 banks
    alignas(16) WARP_SHARED float records[batch * stride];
    WARP_SHARED float outlines[batch * outline];

    // The thread's own splat of the batch, from global memory; `store_record` is the other half
    auto fetch_record = [&](int i, int stop, float* record) {
        record[5] = 0.0f;  // no splat
        if (i >= stop) return;
        const int s = splat_ids.data[i];
        constexpr float log2_e = 1.44269504f;
        record[0] = means2d.data[s][0];
        record[1] = means2d.data[s][1];
        record[2] = conics.data[s][0] * (-0.5f * log2_e);
        record[3] = conics.data[s][1] * -log2_e;
        record[4] = conics.data[s][2] * (-0.5f * log2_e);
        record[5] = opacities.data[s];
        record[6] = depths.data[s];
        for (int d = 0; d < channels; ++d) record[7 + d] = colors.data[s][d];
    };
    auto store_record = [&](int k, const float* record) {
        for (int c = 0; c < 7 + channels; ++c) records[k * stride + c] = record[c];
        float* const e = outlines + k * outline;
        e[3] = -1.0f;  // no height: meets nothing
        if (record[5] > 0.0f) {
            constexpr float ln_2 = 0.693147181f;
            const float a = record[2] * (-2.0f * ln_2), b = record[3] * -ln_2, c = record[4] * (-2.0f * ln_2);
            const float det = wp::max(a * c - b * b, 1e-20f);
            const float level = 2.0f * wp::log(record[5] * 255.0f) + 1e-3f;  // a little more, for rounding
            e[0] = record[0];
            e[1] = record[1];
            e[2] = divide(b, a);
            e[3] = root(divide(level * a, det));
            e[4] = -b * root(divide(level, det * c));
            e[5] = divide(det, a * a);
            e[6] = divide(level, a);
        }
    };
    // Whether splat k of the batch meets the warp's 8 x 4 pixels. Not a number counts as yes.
    auto meets = [&](int k) -> bool {
        const float* const e = outlines + k * outline;
        const float lo = wp::max((float)block_top + 0.5f - e[1], -e[3]);
        const float hi = wp::min((float)block_top + 3.5f - e[1], e[3]);
        if (lo > hi) return false;
        const float at_left = wp::min(wp::max(-e[4], lo), hi), at_right = wp::min(wp::max(e[4], lo), hi);
        const float leftmost = -e[2] * at_left - root(wp::max(e[6] - e[5] * at_left * at_left, 0.0f));
        const float rightmost = -e[2] * at_right + root(wp::max(e[6] - e[5] * at_right * at_right, 0.0f));
        const float x = (float)block_left + 0.5f - e[0];
        return !(leftmost > x + 7.01f) && !(rightmost < x - 0.01f);
    };
    // opacity exp(-sigma) of a record. The multiply-adds are spelled out so that both passes round alike: whether a
    // pixel took a splat must not depend on how a compiler contracts one of them.
    auto opacity_at = [&](const float* record, float dx, float dy) -> float {
        const float half_way = multiply_add(record[3], dy, record[2] * dx);
        return record[5] * power_of_two(multiply_add(record[4] * dy, dy, half_way * dx));
    };
"""
