"""Projection in the CPU's shape: sixteen Gaussians at a time, float32, forward and the adjoint by hand.

The formulas are those of `gaussian.py` and `project.py`, whose adjoint Warp derives; the tests hold the two together.
The lanes of a vector are Gaussians: arrays of vec2, vec3 and vec4 are shuffled apart when read, together when written.

The adjoint, for one Gaussian and camera: with a, b the rows of the root J W R S, n = a x b and e = eps2d, the
determinant D = |n|^2 + e (xx + yy + e) and the conic (yy + e, -xy, xx + e) / D have

    v_D = -(v_conic . conic) / D,
    v_xx = v_conic_c / D + e v_D,   v_xy = -v_conic_b / D,   v_yy = v_conic_a / D + e v_D,
    v_n = 2 v_D n,   v_a = 2 v_xx a + v_xy b + b x v_n,   v_b = 2 v_yy b + v_xy a + v_n x a.

a_k = s_k R_k . u for the columns R_k of the Gaussian's rotation and u = W^T J_x, and so on down to the quaternion. The
compensation sqrt(|n|^2 / D) adds v / (2 sqrt(|n|^2 D)) to v_D in v_n, and takes v sqrt(|n|^2 / D) / (2 D) from v_D.
"""

import warp as wp

from graphgs.kernels.cpu_flags import VECTOR_OPTIONS
from graphgs.kernels.launch import launch_range
from graphgs.kernels.rasterize.constants import ALPHA_MIN, MAX_RADIUS, MAX_SIGMA, MAX_VARIANCE

wp.set_module_options(VECTOR_OPTIONS)

LANES = 16


def _shuffle(a: str, b: str, lanes: list[int]) -> str:
    return f"__builtin_shufflevector({a}, {b}, {', '.join(map(str, lanes))})"


def _apart(width: int) -> str:
    """A function that reads 16 vectors of `width` floats into `width` vectors of 16."""
    body = "".join(f"const lanes s{k} = ((const loose*)from)[{k}];" for k in range(width))
    for k in range(width):
        place = [width * lane + k for lane in range(LANES)]  # among the floats read
        value = "s0"
        for source in range(1, width):
            picks = [
                LANES + at % LANES
                if at // LANES == source
                else (lane if at // LANES < source and source > 1 else at % LANES)
                for lane, at in enumerate(place)
            ]
            value = _shuffle(value, f"s{source}", picks)
        body += f"to[{k}] = {value};"
    return f"auto read{width} = [](const float* from, lanes* to) {{ {body} }};"


def _together(width: int) -> str:
    """The inverse of `_apart`."""
    body = ""
    for k in range(width):
        place = [divmod(LANES * k + lane, width) for lane in range(LANES)]  # (Gaussian, component)
        value = "from[0]"
        for source in range(1, width):
            picks = [
                LANES + g if c == source else (lane if c < source and source > 1 else g)
                for lane, (g, c) in enumerate(place)
            ]
            value = _shuffle(value, f"from[{source}]", picks)
        body += f"((loose*)to)[{k}] = {value};"
    return f"auto write{width} = [](const lanes* from, float* to) {{ {body} }};"


_COMMON = f"""
    typedef float lanes __attribute__((ext_vector_type(16)));
    typedef float loose __attribute__((ext_vector_type(16), aligned(4)));
    typedef int bits __attribute__((ext_vector_type(16)));
    const lanes zero = 0.0f, one = 1.0f;
    {_apart(2)} {_apart(3)} {_apart(4)} {_together(2)} {_together(3)} {_together(4)}

    // The last Gaussians may be fewer than 16: they go through a buffer. The others are read and written in place.
    const int count = gaussians - 16 * group < 16 ? gaussians - 16 * group : 16;
    float buffer[64];
    auto fetch = [&](const float* array, long index, int width, lanes* to) {{
        const float* from = array + index * width;
        if (count < 16) {{
            for (int k = 0; k < 64; ++k) buffer[k] = 0.0f;
            __builtin_memcpy(buffer, from, 4 * width * count);
            from = buffer;
        }}
        if (width == 1) to[0] = *(const loose*)from;
        if (width == 2) read2(from, to);
        if (width == 3) read3(from, to);
        if (width == 4) read4(from, to);
    }};
    auto store = [&](const lanes* from, float* array, long index, int width) {{
        float* to = array + index * width;
        float* target = count < 16 ? buffer : to;
        if (width == 1) *(loose*)target = from[0];
        if (width == 2) write2(from, target);
        if (width == 3) write3(from, target);
        if (width == 4) write4(from, target);
        if (count < 16) __builtin_memcpy(to, buffer, 4 * width * count);
    }};

    lanes mean[3], quat[4], scale[3], opacity;
    fetch((const float*)means.data, 16l * group, 3, mean);
    fetch((const float*)quats.data, 16l * group, 4, quat);
    fetch((const float*)scales.data, 16l * group, 3, scale);
    fetch(opacities.data, 16l * group, 1, &opacity);

    // The columns of the rotation; the zero quaternion gives the identity.
    const lanes squared = quat[0] * quat[0] + quat[1] * quat[1] + quat[2] * quat[2] + quat[3] * quat[3];
    const lanes length = __builtin_elementwise_sqrt(squared);
    const lanes shrink = squared > 0.0f ? one / length : zero;
    const lanes w = quat[0] * shrink, x = quat[1] * shrink, y = quat[2] * shrink, z = quat[3] * shrink;
    const lanes turned[3][3] = {{
        {{one - 2.0f * (y * y + z * z), 2.0f * (x * y + w * z), 2.0f * (x * z - w * y)}},
        {{2.0f * (x * y - w * z), one - 2.0f * (x * x + z * z), 2.0f * (y * z + w * x)}},
        {{2.0f * (x * z + w * y), 2.0f * (y * z - w * x), one - 2.0f * (x * x + y * y)}},
    }};
"""

# Per camera: the root's rows a and b, their normal, and what leads to them
_PROJECT = """
        const float* view = (const float*)viewmats.data + 16l * camera;
        const float* pinhole = (const float*)pinholes.data + 4l * camera;
        const float fx = pinhole[0], fy = pinhole[1], cx = pinhole[2], cy = pinhole[3];
        const float limits[4] = {
            -(cx + 0.15f * width) / fx, (width - cx + 0.15f * width) / fx,
            -(cy + 0.15f * height) / fy, (height - cy + 0.15f * height) / fy,
        };
        lanes point[3];
        for (int k = 0; k < 3; ++k)
            point[k] = view[4 * k] * mean[0] + view[4 * k + 1] * mean[1] + view[4 * k + 2] * mean[2] + view[4 * k + 3];
        const lanes inverse = one / point[2];
        const lanes raw_x = point[0] * inverse, raw_y = point[1] * inverse;
        const lanes low_x = raw_x < limits[0] ? (lanes)limits[0] : raw_x;
        const lanes low_y = raw_y < limits[2] ? (lanes)limits[2] : raw_y;
        const lanes slope_x = low_x > limits[1] ? (lanes)limits[1] : low_x;
        const lanes slope_y = low_y > limits[3] ? (lanes)limits[3] : low_y;
        // Rows of the Jacobian (x: 1st and 3rd entry, y: 2nd and 3rd), then turned into the world
        const lanes row_x = fx * inverse, row_y = fy * inverse, row_xz = -row_x * slope_x, row_yz = -row_y * slope_y;
        lanes u[3], v[3], along_u[3], along_v[3], a[3], b[3];
        for (int k = 0; k < 3; ++k) {
            u[k] = view[k] * row_x + view[8 + k] * row_xz;
            v[k] = view[4 + k] * row_y + view[8 + k] * row_yz;
        }
        for (int k = 0; k < 3; ++k) {
            along_u[k] = turned[k][0] * u[0] + turned[k][1] * u[1] + turned[k][2] * u[2];
            along_v[k] = turned[k][0] * v[0] + turned[k][1] * v[1] + turned[k][2] * v[2];
            a[k] = scale[k] * along_u[k];
            b[k] = scale[k] * along_v[k];
        }
        const lanes normal[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
        const lanes xx = a[0] * a[0] + a[1] * a[1] + a[2] * a[2], xy = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        const lanes yy = b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
        const lanes sharp = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2];
        const lanes blurred = sharp + eps2d * (xx + yy + eps2d);
        const lanes conic[3] = {(yy + eps2d) / blurred, -xy / blurred, (xx + eps2d) / blurred};
        const lanes ratio = sharp / blurred;
        const lanes compensation = ratio > 0.0f ? __builtin_elementwise_sqrt(ratio) : zero;
"""


@wp.func_native(
    _COMMON
    + f"""
    auto at_most = [](lanes value, float limit) -> lanes {{ return value < limit ? value : (lanes)limit; }};
    for (int camera = 0; camera < cameras; ++camera) {{
        const long at = (long)camera * gaussians + 16l * group;
        {_PROJECT}
        const lanes shown = antialiased ? opacity * compensation : opacity;
        const lanes visible = shown >= {float(ALPHA_MIN)!r}f ? shown : one;
        const lanes level = 2.0f * __builtin_elementwise_log(visible * {1 / float(ALPHA_MIN)!r}f);
        const lanes reach = at_most(__builtin_elementwise_sqrt(level), {float(MAX_SIGMA)!r}f);
        const lanes spread_x = __builtin_elementwise_sqrt(xx + eps2d);
        const lanes spread_y = __builtin_elementwise_sqrt(yy + eps2d);
        const lanes radius_x = at_most(__builtin_elementwise_ceil(reach * spread_x), {float(MAX_RADIUS)!r}f);
        const lanes radius_y = at_most(__builtin_elementwise_ceil(reach * spread_y), {float(MAX_RADIUS)!r}f);
        const lanes mean_x = fx * raw_x + cx, mean_y = fy * raw_y + cy;
        const bits kept = (point[2] > near) & (point[2] < far) & (shown >= {float(ALPHA_MIN)!r}f)
            & (xx + yy + 2.0f * eps2d < {float(MAX_VARIANCE)!r}f) & (blurred > 0.0f)
            & (mean_x + radius_x > 0.0f) & (mean_x - radius_x < (float)width)
            & (mean_y + radius_y > 0.0f) & (mean_y - radius_y < (float)height);
        const lanes centers[2] = {{kept ? mean_x : zero, kept ? mean_y : zero}};
        const lanes shapes[3] = {{kept ? conic[0] : zero, kept ? conic[1] : zero, kept ? conic[2] : zero}};
        const lanes depth = kept ? point[2] : zero, strength = kept ? shown : zero;
        const lanes whole_x = radius_x > 1.0f ? radius_x : one, whole_y = radius_y > 1.0f ? radius_y : one;
        const lanes extents[2] = {{
            (lanes)__builtin_convertvector(kept ? whole_x : zero, bits),
            (lanes)__builtin_convertvector(kept ? whole_y : zero, bits),
        }};
        store(centers, (float*)means2d.data, at, 2);
        store(shapes, (float*)conics.data, at, 3);
        store(&depth, depths.data, at, 1);
        store(&strength, splat_opacities.data, at, 1);
        store(extents, (float*)radii.data, at, 2);
    }}
    """
)
def project_group(
    group: int,
    gaussians: int,
    cameras: int,
    means: wp.array[wp.vec3],
    quats: wp.array[wp.vec4],
    scales: wp.array[wp.vec3],
    opacities: wp.array[float],
    viewmats: wp.array[wp.mat44],
    pinholes: wp.array[wp.vec4],
    width: int,
    height: int,
    near: float,
    far: float,
    eps2d: float,
    antialiased: bool,
    means2d: wp.array[wp.vec2],
    conics: wp.array[wp.vec3],
    depths: wp.array[float],
    splat_opacities: wp.array[float],
    radii: wp.array[wp.vec2i],
):
    """Project Gaussians 16 * group .. 16 * group + 15 into every camera."""


@wp.kernel
def project_lanes(
    first: int,
    # Gaussians
    means: wp.array[wp.vec3],  # [N]
    quats: wp.array[wp.vec4],
    scales: wp.array[wp.vec3],
    opacities: wp.array[float],
    # Cameras
    viewmats: wp.array[wp.mat44],  # [C]
    pinholes: wp.array[wp.vec4],  # [C] fx, fy, cx, cy
    width: int,
    height: int,
    near: float,
    far: float,
    eps2d: float,
    antialiased: bool,
    # Out, [C * N]
    means2d: wp.array[wp.vec2],
    conics: wp.array[wp.vec3],
    depths: wp.array[float],
    splat_opacities: wp.array[float],
    radii: wp.array[wp.vec2i],  # 0 = not visible, and then all else is 0
):
    project_group(
        first + wp.tid(),
        means.shape[0],
        viewmats.shape[0],
        means,
        quats,
        scales,
        opacities,
        viewmats,
        pinholes,
        width,
        height,
        near,
        far,
        eps2d,
        antialiased,
        means2d,
        conics,
        depths,
        splat_opacities,
        radii,
    )


@wp.func_native(
    _COMMON
    + f"""
    lanes v_mean[3] = {{zero, zero, zero}}, v_scale[3] = {{zero, zero, zero}}, v_opacity = zero;
    lanes v_turned[3][3];
    for (int k = 0; k < 3; ++k)
        for (int l = 0; l < 3; ++l) v_turned[k][l] = zero;
    for (int camera = 0; camera < cameras; ++camera) {{
        const long at = (long)camera * gaussians + 16l * group;
        lanes extents[2], v_center[2], v_conic[3], v_depth, v_shown;
        fetch((const float*)radii.data, at, 2, extents);
        const bits kept = (bits)extents[0] > 0;
        if (!__builtin_reduce_or(kept)) {{
            if (shares_wanted)
                for (int k = 0; k < 16 * count; ++k) ((float*)v_cameras.data)[16 * at + k] = 0.0f;
            continue;
        }}
        fetch((const float*)v_means2d.data, at, 2, v_center);
        fetch((const float*)v_conics.data, at, 3, v_conic);
        fetch(v_depths.data, at, 1, &v_depth);
        fetch(v_splat_opacities.data, at, 1, &v_shown);
        {_PROJECT}
        // Compensation
        const lanes v_compensation = antialiased ? v_shown * opacity : zero;
        v_opacity += kept ? (antialiased ? v_shown * compensation : v_shown) : zero;
        const lanes v_ratio = compensation > 0.0f ? 0.5f * v_compensation / compensation : zero;

        // Conic, determinant, covariance, root
        const lanes pull = v_conic[0] * conic[0] + v_conic[1] * conic[1] + v_conic[2] * conic[2];
        const lanes v_blurred = -(pull + v_ratio * ratio) / blurred;
        const lanes v_xx = v_conic[2] / blurred + eps2d * v_blurred;
        const lanes v_xy = -v_conic[1] / blurred;
        const lanes v_yy = v_conic[0] / blurred + eps2d * v_blurred;
        const lanes v_sharp = 2.0f * (v_blurred + v_ratio / blurred);
        const lanes v_normal[3] = {{v_sharp * normal[0], v_sharp * normal[1], v_sharp * normal[2]}};
        lanes v_a[3], v_b[3], v_u[3] = {{zero, zero, zero}}, v_v[3] = {{zero, zero, zero}};
        for (int k = 0; k < 3; ++k) {{
            const int l = (k + 1) % 3, m = (k + 2) % 3;
            v_a[k] = 2.0f * v_xx * a[k] + v_xy * b[k] + (b[l] * v_normal[m] - b[m] * v_normal[l]);
            v_b[k] = 2.0f * v_yy * b[k] + v_xy * a[k] + (v_normal[l] * a[m] - v_normal[m] * a[l]);
        }}
        for (int k = 0; k < 3; ++k) {{
            v_scale[k] += kept ? v_a[k] * along_u[k] + v_b[k] * along_v[k] : zero;
            const lanes v_along_u = v_a[k] * scale[k], v_along_v = v_b[k] * scale[k];
            for (int l = 0; l < 3; ++l) {{
                v_turned[k][l] += kept ? v_along_u * u[l] + v_along_v * v[l] : zero;
                v_u[l] += v_along_u * turned[k][l];
                v_v[l] += v_along_v * turned[k][l];
            }}
        }}

        // Jacobian and mean
        lanes v_row_x = zero, v_row_xz = zero, v_row_y = zero, v_row_yz = zero;
        for (int k = 0; k < 3; ++k) {{
            v_row_x += view[k] * v_u[k];
            v_row_xz += view[8 + k] * v_u[k];
            v_row_y += view[4 + k] * v_v[k];
            v_row_yz += view[8 + k] * v_v[k];
        }}
        const lanes v_slope_x = -row_x * v_row_xz, v_slope_y = -row_y * v_row_yz;
        const lanes v_focus_x = v_row_x - slope_x * v_row_xz, v_focus_y = v_row_y - slope_y * v_row_yz;  // of f / z
        const bits free_x = (raw_x >= limits[0]) & (raw_x <= limits[1]);
        const bits free_y = (raw_y >= limits[2]) & (raw_y <= limits[3]);
        const lanes v_raw_x = fx * v_center[0] + (free_x ? v_slope_x : zero);
        const lanes v_raw_y = fy * v_center[1] + (free_y ? v_slope_y : zero);
        const lanes v_inverse = fx * v_focus_x + fy * v_focus_y + point[0] * v_raw_x + point[1] * v_raw_y;
        const lanes v_point[3] = {{
            kept ? v_raw_x * inverse : zero,
            kept ? v_raw_y * inverse : zero,
            kept ? v_depth - v_inverse * inverse * inverse : zero,
        }};
        for (int k = 0; k < 3; ++k)
            v_mean[k] += view[k] * v_point[0] + view[4 + k] * v_point[1] + view[8 + k] * v_point[2];

        if (shares_wanted) {{  // by rotation (rows), translation and pinhole
            lanes share[16];
            for (int k = 0; k < 3; ++k) {{
                share[k] = v_point[0] * mean[k] + (kept ? row_x * v_u[k] : zero);
                share[3 + k] = v_point[1] * mean[k] + (kept ? row_y * v_v[k] : zero);
                share[6 + k] = v_point[2] * mean[k] + (kept ? row_xz * v_u[k] + row_yz * v_v[k] : zero);
                share[9 + k] = v_point[k];
            }}
            // The limits are (offset - c) / f.
            const lanes held_x = free_x ? zero : v_slope_x, held_y = free_y ? zero : v_slope_y;
            share[12] = kept ? inverse * v_focus_x + raw_x * v_center[0] - held_x * slope_x / fx : zero;
            share[13] = kept ? inverse * v_focus_y + raw_y * v_center[1] - held_y * slope_y / fy : zero;
            share[14] = kept ? v_center[0] - held_x / fx : zero;
            share[15] = kept ? v_center[1] - held_y / fy : zero;
            for (int g = 0; g < count; ++g)
                for (int k = 0; k < 16; ++k) ((float*)v_cameras.data)[16 * (at + g) + k] = share[k][g];
        }}
    }}

    // Rotation to quaternion, and through its normalisation
    auto t = [&](int row, int column) -> lanes {{ return v_turned[column][row]; }};
    const lanes v_unit[4] = {{
        2.0f * (x * (t(2, 1) - t(1, 2)) + y * (t(0, 2) - t(2, 0)) + z * (t(1, 0) - t(0, 1))),
        2.0f * (y * (t(0, 1) + t(1, 0)) + z * (t(0, 2) + t(2, 0)) + w * (t(2, 1) - t(1, 2)))
            - 4.0f * x * (t(1, 1) + t(2, 2)),
        2.0f * (x * (t(0, 1) + t(1, 0)) + z * (t(1, 2) + t(2, 1)) + w * (t(0, 2) - t(2, 0)))
            - 4.0f * y * (t(0, 0) + t(2, 2)),
        2.0f * (x * (t(0, 2) + t(2, 0)) + y * (t(1, 2) + t(2, 1)) + w * (t(1, 0) - t(0, 1)))
            - 4.0f * z * (t(0, 0) + t(1, 1)),
    }};
    const lanes radial = w * v_unit[0] + x * v_unit[1] + y * v_unit[2] + z * v_unit[3];
    const lanes v_quat[4] = {{
        (v_unit[0] - w * radial) * shrink, (v_unit[1] - x * radial) * shrink,
        (v_unit[2] - y * radial) * shrink, (v_unit[3] - z * radial) * shrink,
    }};
    store(v_mean, (float*)v_means.data, 16l * group, 3);
    store(v_quat, (float*)v_quats.data, 16l * group, 4);
    store(v_scale, (float*)v_scales.data, 16l * group, 3);
    store(&v_opacity, v_opacities.data, 16l * group, 1);
    """
)
def unproject_group(
    group: int,
    gaussians: int,
    cameras: int,
    means: wp.array[wp.vec3],
    quats: wp.array[wp.vec4],
    scales: wp.array[wp.vec3],
    opacities: wp.array[float],
    viewmats: wp.array[wp.mat44],
    pinholes: wp.array[wp.vec4],
    width: int,
    height: int,
    eps2d: float,
    antialiased: bool,
    radii: wp.array[wp.vec2i],
    v_means2d: wp.array[wp.vec2],
    v_conics: wp.array[wp.vec3],
    v_depths: wp.array[float],
    v_splat_opacities: wp.array[float],
    v_means: wp.array[wp.vec3],
    v_quats: wp.array[wp.vec4],
    v_scales: wp.array[wp.vec3],
    v_opacities: wp.array[float],
    v_cameras: wp.array(dtype=wp.types.vector(16, wp.float32)),
    shares_wanted: bool,
):
    """The adjoint of `project_group`."""


@wp.kernel
def project_lanes_backward(
    first: int,
    # Gaussians
    means: wp.array[wp.vec3],  # [N]
    quats: wp.array[wp.vec4],
    scales: wp.array[wp.vec3],
    opacities: wp.array[float],
    # Cameras
    viewmats: wp.array[wp.mat44],  # [C]
    pinholes: wp.array[wp.vec4],  # [C]
    width: int,
    height: int,
    eps2d: float,
    antialiased: bool,
    # Cotangents, [C * N]
    radii: wp.array[wp.vec2i],
    v_means2d: wp.array[wp.vec2],
    v_conics: wp.array[wp.vec3],
    v_depths: wp.array[float],
    v_splat_opacities: wp.array[float],
    # Out
    v_means: wp.array[wp.vec3],  # [N]
    v_quats: wp.array[wp.vec4],
    v_scales: wp.array[wp.vec3],
    v_opacities: wp.array[float],
    v_cameras: wp.array(dtype=wp.types.vector(16, wp.float32)),  # [C * N] as in project.py; or empty
):
    unproject_group(
        first + wp.tid(),
        means.shape[0],
        viewmats.shape[0],
        means,
        quats,
        scales,
        opacities,
        viewmats,
        pinholes,
        width,
        height,
        eps2d,
        antialiased,
        radii,
        v_means2d,
        v_conics,
        v_depths,
        v_splat_opacities,
        v_means,
        v_quats,
        v_scales,
        v_opacities,
        v_cameras,
        v_cameras.shape[0] > 0,
    )


def launch_lanes(kernel: wp.Kernel, gaussians: int, *, inputs: list, outputs: list, threads: int) -> None:
    """One index for every 16 Gaussians."""
    launch_range(
        kernel,
        -(-gaussians // LANES),
        inputs=inputs,
        outputs=outputs,
        device="cpu",
        threads=threads,
        min_chunk=128,
        chunks_per_thread=4,
    )
