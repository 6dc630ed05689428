"""The adjoint of shading on a GPU, float32: as `shade.py`, but a block writes the coefficients' gradient together.

A Gaussian's 48 numbers lie one behind the other. Written by its own thread they would be 48 stores of 4 bytes, each to
32 places 192 bytes apart; so threads leave basis and colour in shared memory, and consecutive threads write consecutive
numbers.
"""

import warp as wp

from graphgs.kernels.launch import launch_blocks
from graphgs.kernels.sh import BAND_0, band_1, band_2, band_3, band_weights

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

THREADS = wp.constant(256)  # of a block: a Gaussian each

vec1 = wp.types.vector(1, wp.float32)
vec5 = wp.types.vector(5, wp.float32)
vec7 = wp.types.vector(7, wp.float32)


STRIDE = 19  # 16 basis functions and the colour; an odd length keeps the threads of a warp off each other's banks


@wp.func_native(
    f"""
#if defined(__CUDA_ARCH__)
    __shared__ float staged[256 * {STRIDE}];
#else
    static float staged[256 * {STRIDE}];
#endif
    return (uint64_t)(staged + thread * {STRIDE});
    """
)
def own_stage(thread: int) -> wp.uint64:
    """Where the thread leaves its Gaussian's basis and colour for the block."""


def _stage(dtype: type, first: int):
    """A function that leaves a vector there. One band after another: all at once would take 120 registers."""

    @wp.func_native(f"for (int k = 0; k < {dtype._length_}; ++k) ((float*)stage)[{first} + k] = values[k];")
    def stage(stage: wp.uint64, values: dtype):
        """Leave the numbers."""

    return stage


stage_band_0, stage_band_1, stage_band_2, stage_band_3, stage_color = (
    _stage(wp.types.vector(length, wp.float32), first) for length, first in ((1, 0), (3, 1), (5, 4), (7, 9), (3, 16))
)


@wp.func_native(
    f"""
    WP_TILE_SYNC();  // every thread has written its Gaussian's, and reads those of others
    const float* const staged = (const float*)stage - thread * {STRIDE};
    const int length = 3 * v_sh_coeffs.shape[1];
    const int numbers = wp::min(256, v_sh_coeffs.shape[0] - first) * length;
    float* const out = (float*)v_sh_coeffs.data + (long long)first * length;
    int g = thread / length, place = thread % length;
    for (int at = thread; at < numbers; at += 256) {{
        const int k = place / 3;
        float value = camera > 0 ? out[at] : 0.0f;  // this thread's own, of the camera before
        if (k < 16) value += staged[g * {STRIDE} + k] * staged[g * {STRIDE} + 16 + place - 3 * k];
        out[at] = value;
        g += 256 / length;
        place += 256 % length;
        if (place >= length) {{
            place -= length;
            ++g;
        }}
    }}
    WP_TILE_SYNC();  // all is read: the next camera may stage
    """
)
def add_coefficients(
    thread: int,
    stage: wp.uint64,
    first: int,  # Gaussian of the block
    camera: int,  # 0: set, else add
    v_sh_coeffs: wp.array2d[wp.vec3],
):
    """Basis times colour, for the Gaussians of a block; every thread of the block calls it."""


@wp.kernel
def gpu_shade_backward(
    # Gaussians
    means: wp.array[wp.vec3],  # [N]
    sh_coeffs: wp.array2d[wp.vec3],  # [N, K]
    degree: int,
    # Cameras
    centers: wp.array[wp.vec3],  # [C]
    radii: wp.array[wp.vec2i],  # [C * N]
    # Cotangents
    colors: wp.array[wp.vec3],  # [C * N]
    v_colors: wp.array[wp.vec3],  # [C * N]
    # Out
    v_means: wp.array[wp.vec3],  # [N]
    v_sh_coeffs: wp.array2d[wp.vec3],  # [N, K]
    v_directions: wp.array[wp.vec3],  # [C * N] by the vector from camera to Gaussian; or empty
):
    block, thread = wp.tid()
    g = block * THREADS + thread
    v_mean = wp.vec3()
    stage = own_stage(thread)
    stage_band_0(stage, vec1(BAND_0))
    for c in range(centers.shape[0]):
        at = c * means.shape[0] + g
        v_color = wp.vec3()
        v_offset = wp.vec3()
        stage_band_1(stage, wp.vec3())
        stage_band_2(stage, vec5())
        stage_band_3(stage, vec7())
        if g < means.shape[0]:
            if radii[at][0] > 0:
                v_color = v_colors[at]
                for channel in range(3):
                    if colors[at][channel] <= 0.0:  # clamped
                        v_color[channel] = 0.0
                offset = means[g] - centers[c]
                direction = wp.normalize(offset)
                v_direction = wp.vec3()
                if degree >= 1:
                    v_band, basis_1 = wp.grad(band_1)(direction, band_weights(sh_coeffs, g, 1, v_color, wp.vec3()))
                    v_direction += v_band
                    stage_band_1(stage, basis_1)
                if degree >= 2:
                    v_band, basis_2 = wp.grad(band_2)(direction, band_weights(sh_coeffs, g, 4, v_color, vec5()))
                    v_direction += v_band
                    stage_band_2(stage, basis_2)
                if degree >= 3:
                    v_band, basis_3 = wp.grad(band_3)(direction, band_weights(sh_coeffs, g, 9, v_color, vec7()))
                    v_direction += v_band
                    stage_band_3(stage, basis_3)
                # Through the normalisation: only the part across the direction moves it.
                v_offset = (v_direction - wp.dot(v_direction, direction) * direction) / wp.length(offset)
                v_mean += v_offset
            if v_directions.shape[0] > 0:
                v_directions[at] = v_offset
        stage_color(stage, v_color)
        add_coefficients(thread, stage, block * THREADS, c, v_sh_coeffs)
    if g < means.shape[0]:
        v_means[g] = v_mean


def shade_backward_blocks(
    means: wp.array,  # [N] vec3, world
    sh_coeffs: wp.array,  # [N, K] vec3
    centers: wp.array,  # [C] vec3, world
    radii: wp.array,  # [C * N] vec2i
    colors: wp.array,  # [C * N] vec3
    v_colors: wp.array,  # [C * N] vec3
    v_means: wp.array,  # [N] vec3, filled
    v_sh_coeffs: wp.array,  # [N, K] vec3, filled
    v_directions: wp.array,  # [C * N] vec3, filled; or empty
    *,
    degree: int,
    threads: int = 1,  # the CPU's; as in `shade_backward`
) -> None:
    launch_blocks(
        gpu_shade_backward,
        -(-means.size // int(THREADS)),
        inputs=[means, sh_coeffs, degree, centers, radii, colors, v_colors],
        outputs=[v_means, v_sh_coeffs, v_directions],
        device=means.device,
    )
