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

    FLOATS = ("means", "quats", "scales", "opacities", "colors", "viewmats", "backgrounds")

    def leaves(self, dtype: torch.dtype, device: str = "cpu") -> dict[str, Tensor]:
        """Fresh differentiable copies by name."""
        tensors = {name: getattr(self, name) for name in self.FLOATS if getattr(self, name) is not None}
        return {k: v.detach().to(device, dtype).clone().requires_grad_() for k, v in tensors.items()}

    def render(self, function, leaves: dict[str, Tensor], **more):
        """Call `rasterize`, or its twin, on these leaves."""
        operands = dict(leaves)
        backgrounds = operands.pop("backgrounds", None)
        Ks = self.Ks.to(operands["means"])
        return function(
            **operands, Ks=Ks, width=self.width, height=self.height, backgrounds=backgrounds, **self.options, **more
        )


def make_scene(
    n: int,
    width: int = 37,
    height: int = 23,
    *,
    cameras: int = 1,
    sh_coeffs: int = 0,  # K, or 0 for plain colours
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
        colors=uniform(-0.5, 0.5, n, sh_coeffs, 3) if sh_coeffs else uniform(0, 1, n, 3),
        viewmats=viewmats,
        Ks=K.repeat(cameras, 1, 1),
        width=width,
        height=height,
        options=options,
        backgrounds=uniform(0, 1, cameras, 3) if background else None,
    )


def edge_case_scenes() -> dict[str, Scene]:
    """What real data does to a rasterizer, one scene each."""
    plain = make_scene(30)
    turned = plain.quats.clone()
    turned[::3] = 0
    level = plain.means.clone()
    level[:, 2] = 3.0
    ahead = make_scene(40, depth=(-4.0, 5.0), seed=3)
    return {
        "plain": plain,
        "no background": replace(plain, backgrounds=None),
        "sh 3 of 3, two cameras": make_scene(20, cameras=2, sh_coeffs=16, sh_degree=3, seed=1),
        "sh 1 of 3": make_scene(20, sh_coeffs=16, sh_degree=1, seed=2),
        "sh 0": make_scene(20, sh_coeffs=1, sh_degree=0, seed=2),
        "antialiased": make_scene(30, scale=(0.005, 0.1), antialiased=True, seed=4),
        "more in a tile than a batch": make_scene(300, 18, 17, scale=(0.02, 0.2), opacity=(0.01, 0.2), seed=5),
        "behind the camera": ahead,
        "equal depths": replace(
            plain,
            means=level,
            viewmats=torch.eye(4, dtype=torch.float64)[None],
        ),
        "saturated": make_scene(60, scale=(0.5, 1.5), opacity=(1.0, 1.0), seed=6),
        "empty tiles": make_scene(6, 70, 50, spread=0.1, scale=(0.01, 0.05), seed=7),
        "far outside": make_scene(30, spread=4.0, scale=(0.2, 1.0), seed=8),
        "zero quaternions": replace(plain, quats=turned),
        "one pixel": make_scene(5, 1, 1, scale=(0.5, 1.5), seed=9),
        "nothing visible": make_scene(5, depth=(-4.0, -2.0), seed=10),
        "nothing at all": make_scene(0),
    }


def _skew(v: Tensor) -> Tensor:
    zero = torch.zeros_like(v[0])
    return torch.stack([zero, -v[2], v[1], v[2], zero, -v[0], -v[1], v[0], zero]).reshape(3, 3)
