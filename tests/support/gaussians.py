"""Small seeded scenes of Gaussians before a camera, for tests of the rasterizer."""

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor


@dataclass(frozen=True)
class Scene:
    """The operands of `rasterize`, float64, and its options."""

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colors: Tensor
    viewmats: Tensor
    Ks: Tensor
    width: int
    height: int
    options: dict = field(default_factory=dict)
    backgrounds: Tensor | None = None
    masks: Tensor | None = None
    fixed: tuple[str, ...] = ()  # operands whose gradient is not asked for

    FLOATS = ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks", "backgrounds")

    def leaves(self, dtype: torch.dtype, device: str = "cpu") -> dict[str, Tensor]:
        """Fresh copies by name, differentiable unless fixed."""
        tensors = {name: getattr(self, name) for name in self.FLOATS if getattr(self, name) is not None}
        return {
            name: tensor.detach().to(device, dtype).clone().requires_grad_(name not in self.fixed)
            for name, tensor in tensors.items()
        }

    def render(self, function, leaves: dict[str, Tensor], **more):
        """Call `rasterize`, or its twin, on these leaves."""
        if self.masks is not None:
            more = {"masks": self.masks.to(leaves["means"].device)} | more
        return function(**leaves, width=self.width, height=self.height, **(self.options | more))

    def rounded(self) -> "Scene":
        """With operands that float32 holds exactly, so that both precisions render the same scene."""
        tensors = {name: getattr(self, name) for name in self.FLOATS if getattr(self, name) is not None}
        return replace(self, **{name: tensor.float().double() for name, tensor in tensors.items()})


def make_scene(
    n: int,
    width: int = 37,
    height: int = 23,
    *,
    cameras: int = 1,
    sh_coeffs: int = 0,  # K, or 0 for plain colours
    channels: int = 3,  # D of plain colours
    depth: tuple[float, float] = (2.0, 6.0),
    spread: float = 1.2,  # of the means over the image: 1 fills it
    scale: tuple[float, float] = (0.05, 0.5),
    opacity: tuple[float, float] = (0.1, 0.95),
    background: bool = True,
    seed: int = 0,
    **options,
) -> Scene:
    """`n` Gaussians in front of cameras that look along z from nearby places."""
    rng = torch.Generator().manual_seed(seed)

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(*shape, generator=rng, dtype=torch.float64)

    focal = 0.9 * max(width, height)
    z = uniform(*depth, n)
    x = uniform(-0.5, 0.5, n) * spread * width / focal * z
    y = uniform(-0.5, 0.5, n) * spread * height / focal * z
    viewmats = torch.eye(4, dtype=torch.float64).repeat(cameras, 1, 1)
    for c in range(cameras):
        viewmats[c, :3, :3] = torch.linalg.matrix_exp(_skew(uniform(-0.06, 0.06, 3)))
        viewmats[c, :3, 3] = uniform(-0.1, 0.1, 3)
    K = torch.tensor([[focal, 0, 0.52 * width], [0, 1.1 * focal, 0.47 * height], [0, 0, 1]], dtype=torch.float64)
    return Scene(
        means=torch.stack([x, y, z], -1),
        quats=uniform(-1, 1, n, 4),
        scales=uniform(*scale, n, 3),
        opacities=uniform(*opacity, n),
        colors=uniform(-0.5, 0.5, n, sh_coeffs, 3) if sh_coeffs else uniform(0, 1, n, channels),
        viewmats=viewmats,
        Ks=K.repeat(cameras, 1, 1),
        width=width,
        height=height,
        options=options,
        backgrounds=uniform(0, 1, cameras, channels) if background else None,
    ).rounded()


def _skew(v: Tensor) -> Tensor:
    zero = torch.zeros_like(v[0])
    return torch.stack([zero, -v[2], v[1], v[2], zero, -v[0], -v[1], v[0], zero]).reshape(3, 3)
