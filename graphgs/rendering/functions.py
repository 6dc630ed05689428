"""Projection and shading as torch functions; compositing is in `composite.py`.

They are thin: detach, wrap, launch, return. What was wrapped once is kept in `ctx`, beside the saved tensors that torch
guards against changes in place. Arguments are checked at the public edge, in `rasterize`.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from graphgs.kernels.rasterize.buffers import Splats
from graphgs.kernels.rasterize.gpu_shade import shade_backward_blocks
from graphgs.kernels.rasterize.project import Cameras, Gaussians, project, project_backward
from graphgs.kernels.rasterize.shade import shade, shade_backward
from graphgs.rendering.bridge import matrices, scalars, sum_rows, torch_stream, vectors, zeros
from graphgs.threads import get_num_threads


@dataclass(frozen=True)
class ProjectOptions:
    """What projection needs besides tensors; the fields are arguments of `rasterize`."""

    width: int  # [px]
    height: int  # [px]
    near: float
    far: float
    eps2d: float  # [px^2]
    antialiased: bool
    lanes: bool = False  # the CPU's kernels, float32 alone


class Project(Function):
    """Gaussians and cameras -> means2d, conics, depths, opacities, radii, each [C, N, ...]."""

    @staticmethod
    def forward(
        ctx,
        means: Tensor,  # [N, 3] world
        quats: Tensor,  # [N, 4] wxyz
        scales: Tensor,  # [N, 3]
        opacities: Tensor,  # [N]
        viewmats: Tensor,  # [C, 4, 4]
        pinholes: Tensor,  # [C, 4] fx, fy, cx, cy
        options: ProjectOptions,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        size = (viewmats.shape[0], means.shape[0])
        means2d = means.new_empty(*size, 2)
        conics = means.new_empty(*size, 3)
        depths = means.new_empty(size)
        splat_opacities = means.new_empty(size)
        radii = means.new_empty(*size, 2, dtype=torch.int32)
        ctx.gaussians = _gaussians(means, quats, scales, opacities)
        ctx.cameras = Cameras(matrices(viewmats), vectors(pinholes), options.width, options.height)
        ctx.radii = vectors(radii)
        splats = _splats(means2d, conics, depths, splat_opacities)
        with torch_stream(means.device):
            project(
                ctx.gaussians,
                ctx.cameras,
                splats,
                ctx.radii,
                near=options.near,
                far=options.far,
                eps2d=options.eps2d,
                antialiased=options.antialiased,
                lanes=options.lanes,
                threads=get_num_threads(),
            )
        ctx.save_for_backward(means, quats, scales, opacities, viewmats, pinholes)
        ctx.options = options
        ctx.mark_non_differentiable(radii)
        ctx.set_materialize_grads(False)
        return means2d, conics, depths, splat_opacities, radii

    @staticmethod
    @once_differentiable
    def backward(ctx, v_means2d, v_conics, v_depths, v_splat_opacities, _):
        means, quats, scales, opacities, viewmats, _ = ctx.saved_tensors
        v_means, v_quats = torch.empty_like(means), torch.empty_like(quats)
        v_scales, v_opacities = torch.empty_like(scales), torch.empty_like(opacities)
        size = (viewmats.shape[0], means.shape[0])
        cameras_wanted = ctx.needs_input_grad[4] or ctx.needs_input_grad[5]
        v_cameras = means.new_empty(size[0], size[1] if cameras_wanted else 0, 16)
        with torch_stream(means.device):
            project_backward(
                ctx.gaussians,
                ctx.cameras,
                ctx.radii,
                _splats(
                    _dense(v_means2d, (*size, 2), means),
                    _dense(v_conics, (*size, 3), means),
                    _dense(v_depths, size, means),
                    _dense(v_splat_opacities, size, means),
                ),
                _gaussians(v_means, v_quats, v_scales, v_opacities),
                vectors(v_cameras),
                eps2d=ctx.options.eps2d,
                antialiased=ctx.options.antialiased,
                lanes=ctx.options.lanes,
                threads=get_num_threads(),
            )
        v_viewmats, v_pinholes = None, None
        if cameras_wanted:
            v_camera = sum_rows(v_cameras)
            v_viewmats = torch.zeros_like(viewmats)
            v_viewmats[:, :3, :3] = v_camera[:, :9].reshape(-1, 3, 3)
            v_viewmats[:, :3, 3] = v_camera[:, 9:12]
            v_pinholes = v_camera[:, 12:]
        return v_means, v_quats, v_scales, v_opacities, v_viewmats, v_pinholes, None


class Shade(Function):
    """Spherical harmonics seen from camera centres -> colours [C, N, 3]."""

    @staticmethod
    def forward(
        ctx,
        means: Tensor,  # [N, 3] world
        sh_coeffs: Tensor,  # [N, K, 3]
        centers: Tensor,  # [C, 3] camera centres, world
        radii: Tensor,  # [C, N, 2]
        degree: int,
        blocks: bool = False,  # the GPU's kernel, float32 alone
    ) -> Tensor:
        colors = means.new_empty(*radii.shape[:2], 3)
        ctx.arrays = [vectors(means), vectors(sh_coeffs, axes=2), vectors(centers), vectors(radii), vectors(colors)]
        with torch_stream(means.device):
            shade(*ctx.arrays, degree=degree, threads=get_num_threads())
        ctx.save_for_backward(means, sh_coeffs, centers, colors)
        ctx.degree, ctx.blocks = degree, blocks
        return colors

    @staticmethod
    @once_differentiable
    def backward(ctx, v_colors):
        means, sh_coeffs, centers, _ = ctx.saved_tensors
        v_means, v_sh_coeffs = torch.empty_like(means), torch.empty_like(sh_coeffs)
        center_wanted = ctx.needs_input_grad[2]
        v_directions = means.new_empty(centers.shape[0], means.shape[0] if center_wanted else 0, 3)
        with torch_stream(means.device):
            adjoint = shade_backward_blocks if ctx.blocks else shade_backward
            adjoint(
                *ctx.arrays,
                vectors(v_colors.contiguous()),
                vectors(v_means),
                vectors(v_sh_coeffs, axes=2),
                vectors(v_directions),
                degree=ctx.degree,
                threads=get_num_threads(),
            )
        v_centers = -sum_rows(v_directions) if center_wanted else None
        return v_means, v_sh_coeffs, v_centers, None, None, None


def _dense(gradient: Tensor | None, shape: tuple[int, ...], like: Tensor) -> Tensor:
    """A gradient as kernels read it; None stands for 0."""
    return zeros(shape, like) if gradient is None else gradient.contiguous()


def _gaussians(means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor) -> Gaussians:
    return Gaussians(vectors(means), vectors(quats), vectors(scales), scalars(opacities))


def _splats(means2d: Tensor, conics: Tensor, depths: Tensor, opacities: Tensor) -> Splats:
    return Splats(vectors(means2d), vectors(conics), scalars(depths), scalars(opacities))
