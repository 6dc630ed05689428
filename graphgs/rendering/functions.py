"""The three differentiable steps of rendering as torch functions: project, shade, composite.

They are thin: detach, wrap, launch, return. What was wrapped once is kept in `ctx`, beside the saved tensors that torch
guards against changes in place. Arguments are checked at the public edge, in `rasterize`.
"""

from dataclasses import dataclass
from typing import Literal

import torch
import warp as wp
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from graphgs.kernels.rasterize.buffers import Frame, Image, Splats
from graphgs.kernels.rasterize.ordered_sum import ordered_sum
from graphgs.kernels.rasterize.pixels import composite_pixels, composite_pixels_backward
from graphgs.kernels.rasterize.project import Cameras, Gaussians, project, project_backward
from graphgs.kernels.rasterize.shade import shade, shade_backward
from graphgs.kernels.rasterize.tiles import composite_tiles, composite_tiles_backward
from graphgs.rendering.bridge import matrices, scalars, torch_stream, vectors, zeros
from graphgs.threads import get_num_threads

Shape = Literal["pixels", "tiles"]


@dataclass(frozen=True)
class ProjectOptions:
    """What projection needs besides tensors; the fields are arguments of `rasterize`."""

    width: int  # [px]
    height: int  # [px]
    near: float
    far: float
    eps2d: float  # [px^2]
    antialiased: bool


class Project(Function):
    """Gaussians and cameras -> means2d, conics, depths, opacities, radii, each [C, N, ...]. No gradient by pinholes."""

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
                threads=get_num_threads(),
            )
        ctx.save_for_backward(means, quats, scales, opacities, viewmats)
        ctx.options = options
        ctx.mark_non_differentiable(radii)
        ctx.set_materialize_grads(False)
        return means2d, conics, depths, splat_opacities, radii

    @staticmethod
    @once_differentiable
    def backward(ctx, v_means2d, v_conics, v_depths, v_splat_opacities, _):
        means, quats, scales, opacities, viewmats = ctx.saved_tensors
        v_means, v_quats = torch.empty_like(means), torch.empty_like(quats)
        v_scales, v_opacities = torch.empty_like(scales), torch.empty_like(opacities)
        size = (viewmats.shape[0], means.shape[0])
        pose_wanted = ctx.needs_input_grad[4]
        v_poses = means.new_empty(size[0], size[1] if pose_wanted else 0, 12)
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
                vectors(v_poses),
                eps2d=ctx.options.eps2d,
                antialiased=ctx.options.antialiased,
                threads=get_num_threads(),
            )
        v_viewmats = None
        if pose_wanted:
            v_pose = _sum_rows(v_poses)
            v_viewmats = torch.zeros_like(viewmats)
            v_viewmats[:, :3, :3] = v_pose[:, :9].reshape(-1, 3, 3)
            v_viewmats[:, :3, 3] = v_pose[:, 9:]
        return v_means, v_quats, v_scales, v_opacities, v_viewmats, None, None


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
    ) -> Tensor:
        colors = means.new_empty(*radii.shape[:2], 3)
        ctx.arrays = [vectors(means), vectors(sh_coeffs, axes=2), vectors(centers), vectors(radii), vectors(colors)]
        with torch_stream(means.device):
            shade(*ctx.arrays, degree=degree, threads=get_num_threads())
        ctx.save_for_backward(means, sh_coeffs, centers, colors)
        ctx.degree = degree
        return colors

    @staticmethod
    @once_differentiable
    def backward(ctx, v_colors):
        means, sh_coeffs, centers, _ = ctx.saved_tensors
        v_means, v_sh_coeffs = torch.empty_like(means), torch.empty_like(sh_coeffs)
        center_wanted = ctx.needs_input_grad[2]
        v_directions = means.new_empty(centers.shape[0], means.shape[0] if center_wanted else 0, 3)
        with torch_stream(means.device):
            shade_backward(
                *ctx.arrays,
                vectors(v_colors.contiguous()),
                vectors(v_means),
                vectors(v_sh_coeffs, axes=2),
                vectors(v_directions),
                degree=ctx.degree,
                threads=get_num_threads(),
            )
        v_centers = -_sum_rows(v_directions) if center_wanted else None
        return v_means, v_sh_coeffs, v_centers, None, None


class Composite(Function):
    """Projected Gaussians -> colors [C, H, W, 3], alphas [C, H, W, 1], depths [C, H, W, 1]."""

    @staticmethod
    def forward(
        ctx,
        means2d: Tensor,  # [C, N, 2] px
        conics: Tensor,  # [C, N, 3]
        depths: Tensor,  # [C, N]
        opacities: Tensor,  # [C, N]
        colors: Tensor,  # [C, N, 3]
        backgrounds: Tensor,  # [C, 3]
        radii: Tensor,  # [C, N, 2]
        width: int,
        height: int,
        shape: Shape,
    ) -> tuple[Tensor, Tensor, Tensor]:
        cameras = means2d.shape[0]
        render_colors = means2d.new_empty(cameras, height, width, 3)
        render_alphas = means2d.new_empty(cameras, height, width, 1)
        render_depths = means2d.new_empty(cameras, height, width, 1)
        ctx.splats = _splats(means2d, conics, depths, opacities, colors)
        ctx.frame = Frame(cameras, width, height, vectors(backgrounds))
        image = _image(render_colors, render_alphas, render_depths)
        with torch_stream(means2d.device):
            composite = composite_tiles if shape == "tiles" else composite_pixels
            ctx.state = composite(ctx.splats, vectors(radii), ctx.frame, image, threads=get_num_threads())
        ctx.shape = shape
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(means2d, conics, depths, opacities, colors, backgrounds, render_alphas)
        return render_colors, render_alphas, render_depths

    @staticmethod
    @once_differentiable
    def backward(ctx, v_render_colors, v_render_alphas, v_render_depths):
        means2d, conics, depths, opacities, colors, _, render_alphas = ctx.saved_tensors
        v_tensors = [zeros(tensor.shape, means2d) for tensor in (means2d, conics, depths, opacities, colors)]
        v_render_colors = _dense(v_render_colors, (*render_alphas.shape[:3], 3), means2d)
        v_render_alphas = _dense(v_render_alphas, render_alphas.shape, means2d)
        v_render_depths = _dense(v_render_depths, render_alphas.shape, means2d)
        v_image = _image(v_render_colors, v_render_alphas, v_render_depths)
        with torch_stream(means2d.device):
            backward = composite_tiles_backward if ctx.shape == "tiles" else composite_pixels_backward
            backward(ctx.splats, ctx.frame, ctx.state, v_image, _splats(*v_tensors), threads=get_num_threads())
        v_backgrounds = None
        if ctx.needs_input_grad[5]:
            v_backgrounds = _sum_rows(((1 - render_alphas) * v_render_colors).flatten(1, 2))
        return *v_tensors, v_backgrounds, None, None, None, None


def _sum_rows(
    rows: Tensor,  # [C, M, D]
) -> Tensor:  # [C, D]
    """Sum over M in an order that does not depend on the number of threads, which torch's sum does not promise."""
    with torch_stream(rows.device):
        return wp.to_torch(ordered_sum(vectors(rows.contiguous(), axes=2), threads=get_num_threads())).squeeze(1)


def _dense(gradient: Tensor | None, shape: tuple[int, ...], like: Tensor) -> Tensor:
    """A gradient as kernels read it; None stands for 0."""
    return zeros(shape, like) if gradient is None else gradient.contiguous()


def _gaussians(means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor) -> Gaussians:
    return Gaussians(vectors(means), vectors(quats), vectors(scales), scalars(opacities))


def _splats(
    means2d: Tensor,
    conics: Tensor,
    depths: Tensor,
    opacities: Tensor,
    colors: Tensor | None = None,
) -> Splats:
    return Splats(
        vectors(means2d),
        vectors(conics),
        scalars(depths),
        scalars(opacities),
        None if colors is None else vectors(colors),
    )


def _image(colors: Tensor, alphas: Tensor, depths: Tensor) -> Image:
    return Image(vectors(colors), scalars(alphas), scalars(depths))
