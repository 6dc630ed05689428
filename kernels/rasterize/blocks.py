"""Sixteen pixels at a time: the innermost loops of the CPU's rasterizer, written with Clang's vector types.

A tile of 16 x 16 pixels is kept as planes of 256 floats; a plane holds 16 blocks of 4 x 4 pixels one after the other,
so a block is 16 neighbouring floats: one AVX-512 register, two of AVX2, four of NEON. Clang splits the type as the
machine needs. The same loops in plain Warp are correct, but whether LLVM vectorises them changes with the code around.

The formulas are those of `pixels.py`; the tests hold the two shapes together.
"""

import warp as wp

from graphgs.kernels.rasterize.constants import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN

LANES = wp.constant(16)
BLOCK = wp.constant(4)  # [px] side
PLANE = wp.constant(256)  # floats

# Planes of the forward pass. Light is the transmittance, negative once a pixel has stopped.
RED, GREEN, BLUE, DEPTH, LIGHT = (wp.constant(k * 256) for k in range(5))
FORWARD_SIZE = wp.constant(5 * 256 + 16)  # and room to begin at a cache line

# Planes of the backward pass: cotangents of the sums over w, of w itself, the light again, and the loss still behind.
V_RED, V_GREEN, V_BLUE, V_DEPTH, V_WEIGHT, V_LIGHT, REMAINING = (wp.constant(k * 256) for k in range(7))
BACKWARD_SIZE = wp.constant(7 * 256 + 16)

# What `unblend_blocks` writes per splat: the sums over pixels of s = dL/dsigma, s dx, s dy, s dx dx, s dx dy, s dy dy,
# and of w times the cotangents of colour and depth
SUMS = wp.constant(10)

_LANES = f"""
    typedef float lanes __attribute__((ext_vector_type(16), aligned(4)));
    typedef int bits __attribute__((ext_vector_type(16), aligned(4)));
    const lanes column = {{0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3}};
    const lanes row = {{0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3}};
    const lanes zero = 0.0f;
    const float alpha_min = {float(ALPHA_MIN)!r}f, alpha_max = {float(ALPHA_MAX)!r}f;
    const float light_min = {float(TRANSMITTANCE_MIN)!r}f;

    // The splat's record: mean, conic, opacity, colour, depth
    const float* s = records.data + at;
    const float a = s[2], b = s[3], c = s[4], opacity = s[5], red = s[6], green = s[7], blue = s[8], depth = s[9];
    const lanes left = x - s[0] + column, top = y - s[1] + row;

    // exp(-sigma), relative error below 5e-7 where alpha >= alpha_min: 2^whole by its exponent bits, 2^f by a minimax
    // polynomial of degree 5 on [0, 1)
    auto falloff = [](lanes sigma) -> lanes {{
        lanes power = __builtin_elementwise_max(sigma * -1.44269504f, (lanes)-100.0f);
        lanes whole = __builtin_elementwise_floor(power);
        lanes f = power - whole;
        lanes p = 0.0018775744740414742f * f + 0.008989345419571488f;
        p = p * f + 0.055826313579067734f;
        p = p * f + 0.24015361855681225f;
        p = p * f + 0.693153073025006f;
        p = p * f + 0.9999999250666569f;
        return (lanes)((bits)p + (__builtin_convertvector(whole, bits) << 23));
    }};
"""

# `band_extent` of ellipse.py for the four rows of blocks at once
_TOUCHED = """
    typedef float four __attribute__((ext_vector_type(4)));
    typedef int ints __attribute__((ext_vector_type(4)));
    const float slope = s[10], height = s[11], right_y = s[12], flatness = s[13], width = s[14];
    const four band = {0, 4, 8, 12}, none = 0.0f;
    const four lo = __builtin_elementwise_max(y - s[1] + band, (four)-height);
    const four hi = __builtin_elementwise_min(y - s[1] + band + 3.0f, (four)height);
    const four at_left = __builtin_elementwise_min(__builtin_elementwise_max((four)-right_y, lo), hi);
    const four at_right = __builtin_elementwise_min(__builtin_elementwise_max((four)right_y, lo), hi);
    const four left_chord = __builtin_elementwise_max(width - flatness * at_left * at_left, none);
    const four right_chord = __builtin_elementwise_max(width - flatness * at_right * at_right, none);
    const four from_x = s[0] - x - slope * at_left - __builtin_elementwise_sqrt(left_chord);
    const four to_x = s[0] - x - slope * at_right + __builtin_elementwise_sqrt(right_chord);
    const four first_x = __builtin_elementwise_min(__builtin_elementwise_max(from_x, none), (four)16.0f);
    const four last_x = __builtin_elementwise_min(__builtin_elementwise_max(to_x, (four)-1.0f), (four)15.0f);
    const ints first = __builtin_convertvector(__builtin_elementwise_ceil(first_x), ints) >> 2;
    const ints past = (__builtin_convertvector(__builtin_elementwise_floor(last_x), ints) >> 2) + 1;
    const ints row_bits = ((ints)1 << past) - ((ints)1 << first);
    const ints shifts = {0, 4, 8, 12};
    const int touched = __builtin_reduce_or(((lo <= hi) & (first < past) & row_bits) << shifts);
"""


@wp.func_native(
    _LANES
    + _TOUCHED
    + """
    int taken = 0;
    for (unsigned left_to_do = open & touched; left_to_do; left_to_do &= left_to_do - 1) {
        const int block = __builtin_ctz(left_to_do);
        const lanes dx = left + 4.0f * (block & 3), dy = top + 4.0f * (block >> 2);
        lanes* plane = (lanes*)(planes.data + start + 16 * block);  // planes lie 16 blocks apart
        const lanes light = plane[64];
        lanes alpha = opacity * falloff(0.5f * (a * dx * dx + c * dy * dy) + b * dx * dy);
        alpha = __builtin_elementwise_min(alpha, (lanes)alpha_max);
        alpha = alpha < alpha_min ? zero : alpha;
        const lanes behind = light - light * alpha;
        const bits goes_on = behind > light_min;
        const lanes weight = goes_on ? alpha * light : zero;
        plane[0] += weight * red;
        plane[16] += weight * green;
        plane[32] += weight * blue;
        plane[48] += weight * depth;
        plane[64] = goes_on ? behind : -__builtin_elementwise_abs(light);
        taken |= (__builtin_reduce_or(weight > 0.0f) & 1) << block;
    }
    return taken;
    """
)
def blend_blocks(
    records: wp.array[float],
    at: int,  # of the splat
    x: float,  # centre of the tile's first pixel [px]
    y: float,
    open: int,  # a bit for each block that still lets light through
    # In and out
    planes: wp.array[float],  # [FORWARD_SIZE]
    start: int,  # of the first plane
) -> int:
    """Blend a splat over the open blocks that its ellipse meets; a bit for each in which a pixel took it."""


@wp.func_native(
    _LANES
    + """
    lanes s_0 = zero, s_x = zero, s_y = zero, s_xx = zero, s_xy = zero, s_yy = zero;
    lanes g_red = zero, g_green = zero, g_blue = zero, g_depth = zero;
    for (unsigned left_to_do = blocks; left_to_do; left_to_do &= left_to_do - 1) {
        const int block = __builtin_ctz(left_to_do);
        const lanes dx = left + 4.0f * (block & 3), dy = top + 4.0f * (block >> 2);
        lanes* plane = (lanes*)(planes.data + start + 16 * block);
        const lanes v_red = plane[0], v_green = plane[16], v_blue = plane[32], v_depth = plane[48];
        const lanes light = plane[80];
        const lanes raw = opacity * falloff(0.5f * (a * dx * dx + c * dy * dy) + b * dx * dy);
        lanes alpha = __builtin_elementwise_min(raw, (lanes)alpha_max);
        alpha = alpha < alpha_min ? zero : alpha;
        const lanes behind = light - light * alpha;
        const bits goes_on = behind > light_min;
        const lanes weight = goes_on ? alpha * light : zero;
        const lanes gain = plane[64] + v_red * red + v_green * green + v_blue * blue + v_depth * depth;
        const lanes taken = weight * gain;
        const lanes remaining = plane[96] - taken;
        lanes v_sigma = alpha / (1.0f - alpha) * remaining - taken;
        v_sigma = (weight > 0.0f & raw <= alpha_max) ? v_sigma : zero;  // the clamp has no gradient
        plane[80] = goes_on ? behind : -__builtin_elementwise_abs(light);
        plane[96] = remaining;
        const lanes v_x = v_sigma * dx, v_y = v_sigma * dy;
        s_0 += v_sigma;
        s_x += v_x;
        s_y += v_y;
        s_xx += v_x * dx;
        s_xy += v_x * dy;
        s_yy += v_y * dy;
        g_red += weight * v_red;
        g_green += weight * v_green;
        g_blue += weight * v_blue;
        g_depth += weight * v_depth;
    }
    auto sum = [](lanes v) -> float {
        auto v8 = v.lo + v.hi;
        auto v4 = v8.lo + v8.hi;
        return (v4.x + v4.z) + (v4.y + v4.w);
    };
    float* out = sums.data + slot;
    out[0] = sum(s_0);
    out[1] = sum(s_x);
    out[2] = sum(s_y);
    out[3] = sum(s_xx);
    out[4] = sum(s_xy);
    out[5] = sum(s_yy);
    out[6] = sum(g_red);
    out[7] = sum(g_green);
    out[8] = sum(g_blue);
    out[9] = sum(g_depth);
    """
)
def unblend_blocks(
    records: wp.array[float],
    at: int,  # of the splat
    x: float,  # centre of the tile's first pixel [px]
    y: float,
    blocks: int,  # a bit for each block to visit
    # In and out
    planes: wp.array[float],  # [BACKWARD_SIZE]
    start: int,  # of the first plane
    # Out
    sums: wp.array[float],  # SUMS floats are written at `slot`
    slot: int,
):
    """The adjoint of `blend_blocks`, in the same order, front to back (docs/kernels.md derives it)."""


@wp.func_native("return (int)((64 - (unsigned long long)planes.data % 64) % 64) / 4;")
def aligned_start(planes: wp.array[float]) -> int:
    """The first float at the beginning of a cache line: a register's worth of lanes then never spans two."""


@wp.func
def open_blocks(
    planes: wp.array[float],
    lights: int,  # where the plane of light begins
):
    """A bit for each block with a pixel that still lets light through."""
    open = int(0)
    for block in range(16):
        lit = int(0)
        for lane in range(LANES):
            lit += wp.where(planes[wp.max(lights + block * LANES, 0) + lane] > 0.0, 1, 0)
        open = open | (wp.where(lit > 0, 1, 0) << block)
    return open
