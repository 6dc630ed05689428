"""The gradient of a splat from the sums of its intersections, which lie one behind the other: eight threads per splat.

With one thread per splat a warp would wait for its largest splat, which may meet a thousand tiles.
"""

from functools import cache

import warp as wp

from graphgs.kernels.rasterize.gpu_backward import COLOR, row_size

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

SHARERS = wp.constant(8)  # threads per splat; lanes of one warp

_ADD_ROWS = """
    // As in warps.py: on CUDA a thread runs one of the eight lanes, on the CPU the first runs all.
#if defined(__CUDA_ARCH__)
    constexpr int lanes = 1;
#else
    constexpr int lanes = 8;
    if (sharer > 0) return;
#endif
    float total[lanes][row];
    for (int l = 0; l < lanes; ++l) {
        for (int c = 0; c < row; ++c) total[l][c] = 0.0f;
        for (int i = slot + sharer + l; i < end; i += 8) {
            const float* const sums = splat_sums.data + (long long)i * row;
            for (int c = 0; c < row; ++c) total[l][c] += sums[c];
        }
    }
#if defined(__CUDA_ARCH__)
    // The eight lanes of a splat are here together, those of the warp's other splats may not be.
    const unsigned together = 0xffu << (threadIdx.x & 24);
    for (int c = 0; c < row; ++c)
        for (int step = 1; step < 8; step *= 2) total[0][c] += __shfl_xor_sync(together, total[0][c], step, 8);
    if (sharer > 0) return;
#else
    for (int step = 1; step < 8; step *= 2)
        for (int l = 0; l < 8; l += 2 * step)
            for (int c = 0; c < row; ++c) total[l][c] += total[l + step][c];
#endif
    const float* const t = total[0];
    // sigma = (a dx^2 + c dy^2) / 2 + b dx dy, with dx = pixel - mean; alpha = opacity * exp(-sigma)
    const auto conic = conics.data[s];
    v_means2d.data[s] = wp::vec2(-(conic[0] * t[1] + conic[1] * t[2]), -(conic[1] * t[1] + conic[2] * t[2]));
    v_conics.data[s] = wp::vec3(0.5f * t[3], t[4], 0.5f * t[5]);
    v_opacities.data[s] = slot < end ? -t[0] / opacities.data[s] : 0.0f;
    v_depths.data[s] = t[6];
    for (int d = 0; d < channels; ++d) v_colors.data[s][d] = t[color + d];
    if (absolute) v_abs_means2d.data[s] = wp::vec2(t[row - 2], t[row - 1]);
"""


@cache
def gather_splats_kernel(channels: int, absolute: bool):
    vecD = wp.types.vector(channels, wp.float32)
    sizes = f"channels = {channels}, row = {row_size(channels, absolute)}, color = {COLOR}"

    @wp.func_native(f"constexpr int {sizes}; constexpr bool absolute = {int(absolute)};" + _ADD_ROWS)
    def add_rows(
        sharer: int,
        slot: int,
        end: int,
        s: int,
        conics: wp.array[wp.vec3],
        opacities: wp.array[float],
        splat_sums: wp.array[float],
        v_means2d: wp.array[wp.vec2],
        v_conics: wp.array[wp.vec3],
        v_depths: wp.array[float],
        v_opacities: wp.array[float],
        v_colors: wp.array(dtype=vecD),
        v_abs_means2d: wp.array[wp.vec2],
    ):
        """Add up the rows [slot, end) with seven others, and write the splat's gradient."""

    @wp.kernel(enable_backward=False, module="unique", grid_stride=False)
    def gather_splats(
        order: wp.array[int],  # [C * N]
        slot_ends: wp.array[int],  # [C * N]
        # Splats, [C * N]
        conics: wp.array[wp.vec3],
        opacities: wp.array[float],
        splat_sums: wp.array[float],  # [I * row_size]
        # Out, [C * N], 0 where not visible
        v_means2d: wp.array[wp.vec2],
        v_conics: wp.array[wp.vec3],
        v_depths: wp.array[float],
        v_opacities: wp.array[float],
        v_colors: wp.array(dtype=vecD),
        v_abs_means2d: wp.array[wp.vec2],  # or empty
    ):
        thread = wp.tid()
        rank = thread // SHARERS
        slot = int(0)
        if rank > 0:
            slot = slot_ends[rank - 1]
        add_rows(
            thread % SHARERS,
            slot,
            slot_ends[rank],
            order[rank],
            conics,
            opacities,
            splat_sums,
            v_means2d,
            v_conics,
            v_depths,
            v_opacities,
            v_colors,
            v_abs_means2d,
        )

    return gather_splats
