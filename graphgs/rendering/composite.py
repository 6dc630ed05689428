"""Compositing as a torch function: thin, like those in `functions.py`."""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from graphgs.kernels.rasterize.buffers import Frame, Image, Splats
from graphgs.kernels.rasterize.gpu import composite_gpu, composite_gpu_backward
from graphgs.kernels.rasterize.pixels import composite_pixels, composite_pixels_backward
from graphgs.kernels.rasterize.tiles import composite_tiles, composite_tiles_backward
from graphgs.rendering.bridge import flags, scalars, sum_rows, torch_stream, vectors, zeros
from graphgs.threads import get_num_threads

Shape = Literal["pixels", "tiles", "gpu"]

FORWARD = {"pixels": composite_pixels, "tiles": composite_tiles, "gpu": composite_gpu}
BACKWARD = {"pixels": composite_pixels_backward, "tiles": composite_tiles_backward, "gpu": composite_gpu_backward}


@dataclass(frozen=True)
class CompositeOptions:
    """What compositing needs besides tensors; the fields are arguments of `rasterize`."""

    width: int  # [px]
    height: int  # [px]
    median_depth: bool
    absgrad: bool
    shape: Shape


class Composite(Function):
    """Projected Gaussians -> colors [C, H, W, D], alphas, depths and median depths [C, H, W, 1] (the last empty unless
    wanted). With `absgrad`, the backward pass leaves its statistic in `means2d.absgrad`."""

    @staticmethod
    def forward(
        ctx,
        means2d: Tensor,  # [C, N, 2]
        conics: Tensor,  # [C, N, 3]
        depths: Tensor,  # [C, N]
        opacities: Tensor,  # [C, N]
        colors: Tensor,  # [C, N, D]
        backgrounds: Tensor,  # [C, D]
        radii: Tensor,  # [C, N, 2]
        masks: Tensor | None,  # [C, H, W] uint8
        options: CompositeOptions,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        size = (means2d.shape[0], options.height, options.width)
        render_colors = means2d.new_empty(*size, colors.shape[-1])
        render_alphas = means2d.new_empty(*size, 1)
        render_depths = means2d.new_empty(*size, 1)
        render_medians = means2d.new_empty(*size, 1) if options.median_depth else means2d.new_empty(0)
        ctx.splats = _splats(means2d, conics, depths, opacities, colors)
        masks = None if masks is None else flags(masks)
        ctx.frame = Frame(size[0], options.width, options.height, vectors(backgrounds), masks)
        image = _image(render_colors, render_alphas, render_depths, render_medians if options.median_depth else None)
        more = {"exact": True} if options.shape == "gpu" and not any(ctx.needs_input_grad) else {}
        with torch_stream(means2d.device):
            ctx.state = FORWARD[options.shape](
                ctx.splats, vectors(radii), ctx.frame, image, threads=get_num_threads(), **more
            )
        ctx.options = options
        ctx.set_materialize_grads(False)
        if not options.median_depth:
            ctx.mark_non_differentiable(render_medians)
        ctx.save_for_backward(
            means2d, conics, depths, opacities, colors, backgrounds, render_colors, render_alphas, render_depths
        )
        return render_colors, render_alphas, render_depths, render_medians

    @staticmethod
    @once_differentiable
    def backward(ctx, v_colors, v_alphas, v_depths, v_medians):
        means2d, conics, depths, opacities, colors, _, render_colors, render_alphas, _ = ctx.saved_tensors
        on_gpu = ctx.options.shape == "gpu"  # which fills every gradient, and reads what is None as 0
        fresh = torch.empty_like if on_gpu else (lambda tensor: zeros(tensor.shape, tensor))
        v_tensors = [fresh(tensor) for tensor in (means2d, conics, depths, opacities, colors)]
        if ctx.options.absgrad:
            means2d.absgrad = fresh(means2d)
        v_splats = _splats(*v_tensors, means2d.absgrad if ctx.options.absgrad else None)
        v_colors = _dense(v_colors, render_colors)
        v_image = _image(
            v_colors,
            *(v if v is None and on_gpu else _dense(v, render_alphas) for v in (v_alphas, v_depths)),
            _dense(v_medians, render_alphas) if ctx.options.median_depth else None,
        )
        with torch_stream(means2d.device):
            BACKWARD[ctx.options.shape](ctx.splats, ctx.frame, ctx.state, v_image, v_splats, threads=get_num_threads())
        v_backgrounds = None
        if ctx.needs_input_grad[5]:
            v_backgrounds = sum_rows(((1 - render_alphas) * v_colors).flatten(1, 2))
        return *v_tensors, v_backgrounds, None, None, None


def _dense(gradient: Tensor | None, output: Tensor) -> Tensor:
    """A gradient as kernels read it; None stands for 0."""
    return zeros(output.shape, output) if gradient is None else gradient.contiguous()


def _splats(
    means2d: Tensor,
    conics: Tensor,
    depths: Tensor,
    opacities: Tensor,
    colors: Tensor,
    abs_means2d: Tensor | None = None,
) -> Splats:
    return Splats(
        vectors(means2d),
        vectors(conics),
        scalars(depths),
        scalars(opacities),
        vectors(colors),
        None if abs_means2d is None else vectors(abs_means2d),
    )


def _image(colors: Tensor, *planes: Tensor | None) -> Image:  # alphas, depths, median depths
    return Image(vectors(colors), *(None if plane is None else scalars(plane) for plane in planes))
