"""A differentiable render that composites by the frozen yardstick; projection and shading are the product's own."""

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from bench.yardstick import composite_yardstick, composite_yardstick_backward
from graphgs.kernels.rasterize.buffers import Frame, Image, Splats
from graphgs.rendering.bridge import scalars, vectors
from graphgs.rendering.functions import Project, ProjectOptions, Shade
from graphgs.threads import get_num_threads


class CompositeYardstick(Function):
    """Projected Gaussians of the CPU -> colors [C, H, W, 3] before a black background."""

    @staticmethod
    def forward(
        ctx,
        means2d: Tensor,  # [C, N, 2] px
        conics: Tensor,  # [C, N, 3]
        depths: Tensor,  # [C, N]
        opacities: Tensor,  # [C, N]
        colors: Tensor,  # [C, N, 3]
        radii: Tensor,  # [C, N, 2]
        width: int,
        height: int,
    ) -> Tensor:
        cameras = means2d.shape[0]
        size = (cameras, height, width)
        render_colors, alphas, render_depths = (means2d.new_empty(*size, d) for d in (3, 1, 1))
        ctx.splats = _splats(means2d, conics, depths, opacities, colors)
        ctx.frame = Frame(cameras, width, height, vectors(means2d.new_zeros(cameras, 3)))
        image = Image(vectors(render_colors), scalars(alphas), scalars(render_depths))
        ctx.state = composite_yardstick(ctx.splats, vectors(radii), ctx.frame, image, threads=get_num_threads())
        ctx.save_for_backward(means2d, conics, depths, opacities, colors)
        ctx.v_unused = torch.zeros_like(alphas)
        return render_colors

    @staticmethod
    @once_differentiable
    def backward(ctx, v_render_colors):
        v_tensors = [torch.zeros_like(tensor) for tensor in ctx.saved_tensors]
        v_unused = scalars(ctx.v_unused)
        v_image = Image(vectors(v_render_colors.contiguous()), v_unused, v_unused)
        composite_yardstick_backward(ctx.splats, ctx.frame, ctx.state, v_image, _splats(*v_tensors))
        return *v_tensors, None, None, None


def yardstick_render(
    means: Tensor,  # [N, 3] world
    quats: Tensor,  # [N, 4] wxyz
    scales: Tensor,  # [N, 3]
    opacities: Tensor,  # [N]
    sh_coeffs: Tensor,  # [N, K, 3]
    viewmats: Tensor,  # [C, 4, 4] world-to-camera
    Ks: Tensor,  # [C, 3, 3]
    width: int,
    height: int,
    *,
    sh_degree: int,
) -> Tensor:  # [C, H, W, 3]
    pinholes = torch.stack([Ks[:, 0, 0], Ks[:, 1, 1], Ks[:, 0, 2], Ks[:, 1, 2]], dim=-1)
    options = ProjectOptions(width, height, near=0.01, far=1e10, eps2d=0.3, antialiased=False)
    *splats, radii = Project.apply(means, quats, scales, opacities, viewmats, pinholes, options)
    centers = -(viewmats[:, :3, :3] * viewmats[:, :3, 3:]).sum(dim=1)
    colors = Shade.apply(means, sh_coeffs, centers, radii, sh_degree)
    return CompositeYardstick.apply(*splats, colors, radii, width, height)


def _splats(means2d: Tensor, conics: Tensor, depths: Tensor, opacities: Tensor, colors: Tensor) -> Splats:
    return Splats(vectors(means2d), vectors(conics), scalars(depths), scalars(opacities), vectors(colors))
