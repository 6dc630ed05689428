"""Project Gaussians into cameras, and the adjoint: one thread per Gaussian, which visits all cameras."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

from graphgs.kernels.gaussian import (
    blur,
    blur_compensation,
    conic_from_covariance,
    jacobian_limits,
    project_gaussian,
    split_viewmat,
)
from graphgs.kernels.launch import launch_range
from graphgs.kernels.rasterize.buffers import Splats
from graphgs.kernels.rasterize.constants import ALPHA_MIN, MAX_RADIUS, MAX_SIGMA, MAX_VARIANCE
from graphgs.kernels.rasterize.project_lanes import launch_lanes, project_lanes, project_lanes_backward


@dataclass(frozen=True)
class Gaussians:
    """The Gaussians to project, or their gradients."""

    means: wp.array  # [N] vec3, world
    quats: wp.array  # [N] vec4 wxyz
    scales: wp.array  # [N] vec3
    opacities: wp.array  # [N]


@dataclass(frozen=True)
class Cameras:
    viewmats: wp.array  # [C] mat44, world-to-camera
    pinholes: wp.array  # [C] vec4: fx, fy, cx, cy [px]
    width: int  # [px]
    height: int  # [px]


@wp.func
def splat_pairing(
    # The Gaussian and the camera, as in `project_gaussian`
    mean: Any,
    quat: Any,
    scale: Any,
    rotation: Any,
    translation: Any,
    pinhole: Any,
    limits: Any,
    eps2d: Any,
    # Cotangents
    v_mean2d: Any,
    v_conic: Any,
    v_depth: Any,
    v_compensation: Any,
):
    """The cotangents paired with the outputs: the gradient of this sum is the projection's adjoint; Warp derives it."""
    mean2d, covariance, depth = project_gaussian(mean, quat, scale, rotation, translation, pinhole, limits)
    blurred = blur(covariance, eps2d)
    conic = conic_from_covariance(blurred)
    compensation = blur_compensation(covariance, blurred)
    return wp.dot(v_mean2d, mean2d) + wp.dot(v_conic, conic) + v_depth * depth + v_compensation * compensation


@cache
def project_forward_kernel(real):
    vec2, vec3, vec4 = (wp.types.vector(length, real) for length in (2, 3, 4))
    mat44 = wp.types.matrix((4, 4), real)

    @wp.kernel(enable_backward=False, module="unique")
    def project_forward(
        first: int,
        # Gaussians
        means: wp.array(dtype=vec3),  # [N]
        quats: wp.array(dtype=vec4),  # [N]
        scales: wp.array(dtype=vec3),  # [N]
        opacities: wp.array(dtype=real),  # [N]
        # Cameras
        viewmats: wp.array(dtype=mat44),  # [C]
        pinholes: wp.array(dtype=vec4),  # [C] fx, fy, cx, cy
        width: int,
        height: int,
        near: real,
        far: real,
        eps2d: real,
        antialiased: bool,
        # Out, [C * N]
        means2d: wp.array(dtype=vec2),
        conics: wp.array(dtype=vec3),
        depths: wp.array(dtype=real),
        splat_opacities: wp.array(dtype=real),
        radii: wp.array(dtype=wp.vec2i),  # 0 = not visible, and then all else is 0
    ):
        g = first + wp.tid()
        mean = means[g]
        for c in range(viewmats.shape[0]):
            at = c * means.shape[0] + g
            means2d[at] = vec2()
            conics[at] = vec3()
            depths[at] = real(0.0)
            splat_opacities[at] = real(0.0)
            radii[at] = wp.vec2i(0, 0)

            pinhole = pinholes[c]
            rotation, translation = split_viewmat(viewmats[c])
            z = wp.dot(rotation[2], mean) + translation[2]
            if z > near and z < far:  # before the division: a Gaussian behind the camera gives inf
                mean2d, covariance, depth = project_gaussian(
                    mean, quats[g], scales[g], rotation, translation, pinhole, jacobian_limits(pinhole, width, height)
                )
                blurred = blur(covariance, eps2d)
                opacity = opacities[g]
                if antialiased:
                    opacity *= blur_compensation(covariance, blurred)
                bounded = blurred[0] + blurred[2] < real(MAX_VARIANCE)  # and no NaN
                if bounded and blurred[3] > real(0.0) and opacity >= real(ALPHA_MIN):
                    # Where alpha falls to ALPHA_MIN, which is tighter than three standard deviations for a faint one.
                    reach = wp.min(real(MAX_SIGMA), wp.sqrt(real(2.0) * wp.log(opacity / real(ALPHA_MIN))))
                    radius_x = wp.min(wp.ceil(reach * wp.sqrt(blurred[0])), real(MAX_RADIUS))
                    radius_y = wp.min(wp.ceil(reach * wp.sqrt(blurred[2])), real(MAX_RADIUS))
                    inside_x = mean2d[0] + radius_x > real(0.0) and mean2d[0] - radius_x < real(width)
                    inside_y = mean2d[1] + radius_y > real(0.0) and mean2d[1] - radius_y < real(height)
                    if inside_x and inside_y:
                        means2d[at] = mean2d
                        conics[at] = conic_from_covariance(blurred)
                        depths[at] = depth
                        splat_opacities[at] = opacity
                        radii[at] = wp.vec2i(wp.max(int(radius_x), 1), wp.max(int(radius_y), 1))

    return project_forward


def project(
    gaussians: Gaussians,
    cameras: Cameras,
    splats: Splats,  # filled, all but the colours
    radii: wp.array,  # [C * N] vec2i, filled
    *,
    near: float,
    far: float,
    eps2d: float,  # [px^2]
    antialiased: bool,
    lanes: bool = False,
    threads: int = 1,
) -> None:
    """`lanes` chooses the CPU's shape, float32 alone."""
    inputs = [*_inputs(gaussians, cameras), near, far, eps2d, antialiased]
    outputs = [splats.means2d, splats.conics, splats.depths, splats.opacities, radii]
    if lanes:
        launch_lanes(project_lanes, gaussians.opacities.size, inputs=inputs, outputs=outputs, threads=threads)
    else:
        kernel = project_forward_kernel(gaussians.opacities.dtype)
        _launch(kernel, gaussians, inputs=inputs, outputs=outputs, threads=threads)


@cache
def project_backward_kernel(real):
    vec2, vec3, vec4, vec16 = (wp.types.vector(length, real) for length in (2, 3, 4, 16))
    mat44 = wp.types.matrix((4, 4), real)

    @wp.kernel(enable_backward=False, module="unique")
    def project_backward(
        first: int,
        # Gaussians
        means: wp.array(dtype=vec3),  # [N]
        quats: wp.array(dtype=vec4),  # [N]
        scales: wp.array(dtype=vec3),  # [N]
        opacities: wp.array(dtype=real),  # [N]
        # Cameras
        viewmats: wp.array(dtype=mat44),  # [C]
        pinholes: wp.array(dtype=vec4),  # [C]
        width: int,
        height: int,
        eps2d: real,
        antialiased: bool,
        # Cotangents, [C * N]
        radii: wp.array(dtype=wp.vec2i),
        v_means2d: wp.array(dtype=vec2),
        v_conics: wp.array(dtype=vec3),
        v_depths: wp.array(dtype=real),
        v_splat_opacities: wp.array(dtype=real),
        # Out
        v_means: wp.array(dtype=vec3),  # [N]
        v_quats: wp.array(dtype=vec4),  # [N]
        v_scales: wp.array(dtype=vec3),  # [N]
        v_opacities: wp.array(dtype=real),  # [N]
        v_cameras: wp.array(dtype=vec16),  # [C * N] by rotation (rows), translation, pinhole: its share; or empty
    ):
        g = first + wp.tid()
        v_mean_sum = vec3()
        v_quat_sum = vec4()
        v_scale_sum = vec3()
        v_opacity_sum = real(0.0)
        for c in range(viewmats.shape[0]):
            at = c * means.shape[0] + g
            v_camera = vec16()
            if radii[at][0] > 0:
                pinhole = pinholes[c]
                limits = jacobian_limits(pinhole, width, height)
                rotation, translation = split_viewmat(viewmats[c])
                v_opacity = v_splat_opacities[at]
                v_compensation = wp.where(antialiased, v_opacity * opacities[g], real(0.0))
                # Warp drops the gradient of what `splat_pairing` calls if this kernel calls the same function itself.
                (
                    v_mean,
                    v_quat,
                    v_scale,
                    v_rotation,
                    v_translation,
                    v_pinhole,
                    v_limits,
                    _eps2d,
                    _v_mean2d,
                    _v_conic,
                    _v_depth,
                    compensation,  # the pairing is linear in its cotangent, so this gradient is the value
                ) = wp.grad(splat_pairing)(
                    means[g],
                    quats[g],
                    scales[g],
                    rotation,
                    translation,
                    pinhole,
                    limits,
                    eps2d,
                    v_means2d[at],
                    v_conics[at],
                    v_depths[at],
                    v_compensation,
                )
                if antialiased:
                    v_opacity *= compensation
                v_mean_sum += v_mean
                v_quat_sum += v_quat
                v_scale_sum += v_scale
                v_opacity_sum += v_opacity
                if v_cameras.shape[0] > 0:
                    for row in range(3):
                        for column in range(3):
                            v_camera[3 * row + column] = v_rotation[row, column]
                        v_camera[9 + row] = v_translation[row]
                    for axis in range(2):  # the limits are (offset - c) / f
                        low, high = v_limits[2 * axis], v_limits[2 * axis + 1]
                        pull = low * limits[2 * axis] + high * limits[2 * axis + 1]
                        v_camera[12 + axis] = v_pinhole[axis] - pull / pinhole[axis]
                        v_camera[14 + axis] = v_pinhole[2 + axis] - (low + high) / pinhole[axis]
            if v_cameras.shape[0] > 0:
                v_cameras[at] = v_camera
        v_means[g] = v_mean_sum
        v_quats[g] = v_quat_sum
        v_scales[g] = v_scale_sum
        v_opacities[g] = v_opacity_sum

    return project_backward


def project_backward(
    gaussians: Gaussians,
    cameras: Cameras,
    radii: wp.array,  # [C * N] vec2i
    v_splats: Splats,
    v_gaussians: Gaussians,  # filled
    v_cameras: wp.array,  # [C * N] vec16, filled; or empty
    *,
    eps2d: float,
    antialiased: bool,
    lanes: bool = False,
    threads: int = 1,
) -> None:
    cotangents = [radii, v_splats.means2d, v_splats.conics, v_splats.depths, v_splats.opacities]
    inputs = [*_inputs(gaussians, cameras), eps2d, antialiased, *cotangents]
    outputs = [v_gaussians.means, v_gaussians.quats, v_gaussians.scales, v_gaussians.opacities, v_cameras]
    if lanes:
        launch_lanes(project_lanes_backward, gaussians.opacities.size, inputs=inputs, outputs=outputs, threads=threads)
    else:
        kernel = project_backward_kernel(gaussians.opacities.dtype)
        _launch(kernel, gaussians, inputs=inputs, outputs=outputs, threads=threads)


def _inputs(gaussians: Gaussians, cameras: Cameras) -> list:
    return [
        gaussians.means,
        gaussians.quats,
        gaussians.scales,
        gaussians.opacities,
        cameras.viewmats,
        cameras.pinholes,
        cameras.width,
        cameras.height,
    ]


def _launch(kernel: wp.Kernel, gaussians: Gaussians, *, inputs: list, outputs: list, threads: int) -> None:
    launch_range(
        kernel,
        gaussians.opacities.size,
        inputs=inputs,
        outputs=outputs,
        device=gaussians.means.device,
        threads=threads,
        min_chunk=1024,
        chunks_per_thread=4,
    )
