"""Render 3D Gaussians: the public, differentiable entry to the rasterizer."""

from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

from graphgs.rendering.checks import check_finite, check_focal, check_masks, check_options, check_tensors
from graphgs.rendering.composite import Composite, CompositeOptions, Shape
from graphgs.rendering.functions import Project, ProjectOptions, Shade


@dataclass(frozen=True)
class RenderOutput:
    """What a render gives. All but `radii` are in the autograd graph."""

    colors: Tensor  # [C, H, W, D]; D is 3 for spherical harmonics
    alphas: Tensor  # [C, H, W, 1] in 0..1
    depths: Tensor  # [C, H, W, 1] expected camera z: sum(w z) / sum(w), 0 where alpha is 0
    means2d: Tensor  # [C, N, 2] px; `means2d.retain_grad()` gives densification its statistic
    radii: Tensor  # [C, N, 2] int, px; 0 = not visible
    median_depths: Tensor | None = None  # [C, H, W, 1] z of the Gaussian that halves the light; 0 where none does


def rasterize(
    means: Tensor,  # [N, 3] world
    quats: Tensor,  # [N, 4] wxyz, need not be unit
    scales: Tensor,  # [N, 3] standard deviations, world units
    opacities: Tensor,  # [N] in 0..1
    colors: Tensor,  # [N, D], D in 1 to 32; or [N, K, 3] spherical harmonics when sh_degree is given
    viewmats: Tensor,  # [C, 4, 4] world-to-camera
    Ks: Tensor,  # [C, 3, 3] px, no skew
    width: int,  # [px]
    height: int,  # [px]
    *,
    sh_degree: int | None = None,  # 0 to 3; may be less than the stored degree
    near: float = 0.01,  # camera z; nearer Gaussians are not drawn
    far: float = 1e10,
    eps2d: float = 0.3,  # [px^2] added to the 2D covariance's diagonal
    antialiased: bool = False,  # scale opacities to undo the brightening by eps2d
    backgrounds: Tensor | None = None,  # [C, D]; None is black
    masks: Tensor | None = None,  # [C, H, W] bool; where False, a pixel sees no Gaussian and passes no gradient
    median_depth: bool = False,  # also render the depth at which half of the light is gone
    absgrad: bool = False,  # the backward pass leaves `means2d.absgrad` [C, N, 2]: the sum of |gradient| over pixels
    validate: bool = True,  # look for NaN and infinite values; on the CPU alone, as a GPU would have to wait
    shape: Shape | None = None,  # kernel shape; None chooses by device and dtype. For tests and benchmarks
) -> RenderOutput:
    """Render N Gaussians into C pinhole cameras, front to back (3DGS, Kerbl et al. 2023; semantics of gsplat).

    alpha = min(0.99, opacity exp(-sigma)); a contribution below 1/255 is skipped, and a pixel stops before its
    transmittance falls to 1e-4. Gaussians of equal depth are drawn in the order of their index.

    Differentiable in means, quats, scales, opacities, colors, viewmats, Ks (its four numbers) and backgrounds; a median
    depth moves with its Gaussian's depth alone. float32 or float64 (all alike). On the CPU the result is the same,
    bit for bit, for any number of threads. Raises ValueError.
    """
    check_tensors(means, quats, scales, opacities, colors, viewmats, Ks, backgrounds, sh_degree=sh_degree)
    check_options(width, height, near, far, eps2d)
    check_masks(masks, (viewmats.shape[0], height, width), means.device)
    if validate and means.device.type == "cpu":
        check_finite(
            means=means,
            quats=quats,
            scales=scales,
            opacities=opacities,
            colors=colors,
            viewmats=viewmats,
            Ks=Ks,
            backgrounds=backgrounds,
        )
        check_focal(Ks)
    shape = _choose_shape(means, shape)

    means, viewmats = means.contiguous(), viewmats.contiguous()
    pinholes = torch.index_select(Ks.reshape(-1, 9), 1, _pinhole_columns(Ks.device))
    means2d, conics, depths, splat_opacities, radii = Project.apply(
        means,
        quats.contiguous(),
        scales.contiguous(),
        opacities.contiguous(),
        viewmats,
        pinholes,
        ProjectOptions(width, height, near, far, eps2d, antialiased, lanes=shape == "tiles"),
    )
    if sh_degree is None:
        splat_colors = colors.expand(viewmats.shape[0], -1, -1).contiguous()
    else:
        # The centre of a camera whose rotation is orthonormal: -R^T t.
        centers = -(viewmats[:, :3, :3] * viewmats[:, :3, 3:]).sum(dim=1)
        splat_colors = Shade.apply(means, colors.contiguous(), centers, radii, sh_degree, shape == "gpu")
    if backgrounds is None:
        backgrounds = means.new_zeros(viewmats.shape[0], splat_colors.shape[-1])
    rendered_colors, alphas, render_depths, median_depths = Composite.apply(
        means2d,
        conics,
        depths,
        splat_opacities,
        splat_colors,
        backgrounds.contiguous(),
        radii,
        None if masks is None else masks.contiguous().view(torch.uint8),
        CompositeOptions(width, height, median_depth, absgrad, shape),
    )
    return RenderOutput(
        colors=rendered_colors,
        alphas=alphas,
        depths=render_depths,
        means2d=means2d,
        radii=radii,
        median_depths=median_depths if median_depth else None,
    )


@cache
def _pinhole_columns(device: torch.device) -> Tensor:
    """Where fx, fy, cx, cy are in a flattened K; there once, as a copy to the device would make the host wait."""
    with torch.inference_mode(False):  # it may be saved for a backward pass
        return torch.tensor([0, 4, 2, 5], device=device)


def _choose_shape(means: Tensor, shape: Shape | None) -> Shape:
    on_cpu, single = means.device.type == "cpu", means.dtype == torch.float32
    if shape is None:
        return ("tiles" if on_cpu else "gpu") if single else "pixels"
    if shape not in ("pixels", "tiles", "gpu"):
        raise ValueError(f"shape: expected 'pixels', 'tiles', 'gpu' or None, got {shape!r}")
    if shape == "tiles" and not (on_cpu and single):
        raise ValueError(f"shape: 'tiles' expects float32 on the CPU, got {means.dtype} on {means.device}")
    if shape == "gpu" and not single:
        raise ValueError(f"shape: 'gpu' expects float32, got {means.dtype}")
    return shape
