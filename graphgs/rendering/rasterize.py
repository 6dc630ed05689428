"""Render 3D Gaussians: the public, differentiable entry to the rasterizer."""

from dataclasses import dataclass

import torch
from torch import Tensor

from graphgs.rendering.functions import Composite, Project, ProjectOptions, Shade, Shape


@dataclass(frozen=True)
class RenderOutput:
    """What a render gives. All but `radii` are in the autograd graph."""

    colors: Tensor  # [C, H, W, 3]
    alphas: Tensor  # [C, H, W, 1] in 0..1
    depths: Tensor  # [C, H, W, 1] expected camera z: sum(w z) / sum(w), 0 where alpha is 0
    means2d: Tensor  # [C, N, 2] px; `means2d.retain_grad()` gives densification its statistic
    radii: Tensor  # [C, N, 2] int, px; 0 = not visible


def rasterize(
    means: Tensor,  # [N, 3] world
    quats: Tensor,  # [N, 4] wxyz, need not be unit
    scales: Tensor,  # [N, 3] standard deviations, world units
    opacities: Tensor,  # [N] in 0..1
    colors: Tensor,  # [N, 3] RGB, or [N, K, 3] spherical harmonics when sh_degree is given
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
    backgrounds: Tensor | None = None,  # [C, 3]; None is black
    shape: Shape | None = None,  # kernel shape; None chooses by device and dtype. For tests and benchmarks
) -> RenderOutput:
    """Render N Gaussians into C pinhole cameras, front to back (3DGS, Kerbl et al. 2023; semantics of gsplat).

    alpha = min(0.99, opacity exp(-sigma)); a contribution below 1/255 is skipped, and a pixel stops before its
    transmittance falls to 1e-4. Gaussians of equal depth are drawn in the order of their index.

    Differentiable in means, quats, scales, opacities, colors, viewmats and backgrounds; not in Ks. float32 or
    float64 (all alike). On the CPU the result is the same, bit for bit, for any number of threads. Raises ValueError.
    """
    if backgrounds is None:
        backgrounds = means.new_zeros(viewmats.shape[0], 3)
    _check(means, quats, scales, opacities, colors, viewmats, Ks, backgrounds, sh_degree)
    _check_options(width, height, near, far, eps2d)
    shape = _choose_shape(means, shape)

    viewmats = viewmats.contiguous()
    pinholes = torch.stack([Ks[:, 0, 0], Ks[:, 1, 1], Ks[:, 0, 2], Ks[:, 1, 2]], dim=-1).detach()
    options = ProjectOptions(width, height, near, far, eps2d, antialiased)
    means = means.contiguous()
    means2d, conics, depths, splat_opacities, radii = Project.apply(
        means, quats.contiguous(), scales.contiguous(), opacities.contiguous(), viewmats, pinholes, options
    )
    if sh_degree is None:
        splat_colors = colors.expand(viewmats.shape[0], -1, -1).contiguous()
    else:
        # The centre of a camera whose rotation is orthonormal: -R^T t.
        centers = -(viewmats[:, :3, :3] * viewmats[:, :3, 3:]).sum(dim=1)
        splat_colors = Shade.apply(means, colors.contiguous(), centers, radii, sh_degree)
    rendered = Composite.apply(
        means2d, conics, depths, splat_opacities, splat_colors, backgrounds.contiguous(), radii, width, height, shape
    )
    return RenderOutput(*rendered, means2d=means2d, radii=radii)


def _choose_shape(means: Tensor, shape: Shape | None) -> Shape:
    if shape is None:
        return "tiles" if means.device.type == "cpu" and means.dtype == torch.float32 else "pixels"
    if shape == "tiles" and (means.device.type != "cpu" or means.dtype != torch.float32):
        raise ValueError(f"shape: 'tiles' expects float32 on the CPU, got {means.dtype} on {means.device}")
    return shape


def _check(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    backgrounds: Tensor,
    sh_degree: int | None,
) -> None:
    if means.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"means: expected float32 or float64, got {means.dtype}")
    n = means.shape[0] if means.dim() else 0
    c = viewmats.shape[0] if viewmats.dim() else 0
    expected = {
        "means": (means, (n, 3)),
        "quats": (quats, (n, 4)),
        "scales": (scales, (n, 3)),
        "opacities": (opacities, (n,)),
        "viewmats": (viewmats, (c, 4, 4)),
        "Ks": (Ks, (c, 3, 3)),
        "backgrounds": (backgrounds, (c, 3)),
    }
    if sh_degree is None:
        expected["colors"] = (colors, (n, 3))
    else:
        if sh_degree not in (0, 1, 2, 3):
            raise ValueError(f"sh_degree: expected 0, 1, 2, 3 or None, got {sh_degree}")
        k = colors.shape[1] if colors.dim() == 3 else 0
        if k < (sh_degree + 1) ** 2:
            wanted = f"[{n}, K, 3] with K >= {(sh_degree + 1) ** 2} for sh_degree={sh_degree}"
            raise ValueError(f"colors: expected {wanted}, got {list(colors.shape)}")
        expected["colors"] = (colors, (n, k, 3))
    for name, (tensor, size) in expected.items():
        if tuple(tensor.shape) != size:
            raise ValueError(f"{name}: expected {list(size)}, got {list(tensor.shape)}")
        if tensor.dtype != means.dtype:
            raise ValueError(f"{name}: expected {means.dtype} as means, got {tensor.dtype}")
        if tensor.device != means.device:
            raise ValueError(f"{name}: expected device {means.device} as means, got {tensor.device}")
    if c < 1:
        raise ValueError("viewmats: expected at least one camera, got none")


def _check_options(width: int, height: int, near: float, far: float, eps2d: float) -> None:
    if width < 1 or height < 1:
        raise ValueError(f"width and height: expected at least 1, got {width} x {height}")
    if not 0 < near < far:
        raise ValueError(f"near and far: expected 0 < near < far, got {near} and {far}")
    if eps2d < 0:
        raise ValueError(f"eps2d: expected at least 0, got {eps2d}")
