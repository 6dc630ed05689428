"""The scenes that the rasterizer's benchmarks render: recorded ones where they are at hand, else procedural."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

RECORDED = Path(__file__).resolve().parents[2] / "shared" / "data" / "raster"
FOCAL_SHARE = 350.0 / 480  # focal length of a procedural scene, in image heights
SPLIT_SHRINK = 1.6  # as densification splits a Gaussian (3DGS)


@dataclass(frozen=True)
class Scene:
    means: Tensor  # [N, 3]
    quats: Tensor  # [N, 4]
    scales: Tensor  # [N, 3]
    opacities: Tensor  # [N]
    sh_coeffs: Tensor  # [N, 16, 3]
    viewmats: Tensor  # [1, 4, 4]
    Ks: Tensor  # [1, 3, 3]
    width: int
    height: int
    v_image: Tensor  # [1, H, W, 3] cotangent
    source: str

    def leaves(self, device: str) -> list[Tensor]:
        """means, quats, scales, opacities, sh_coeffs, differentiable."""
        values = (self.means, self.quats, self.scales, self.opacities, self.sh_coeffs)
        return [value.to(device, copy=True).requires_grad_() for value in values]


def scene(name: str) -> Scene:
    """2k, 10k and 50k at 270 x 480; 500k and 1m at 1920 x 1080."""
    if name == "50k":
        return split(scene("10k"), 5)
    if name in ("500k", "1m"):
        return procedural({"500k": 500_000, "1m": 1_000_000}[name], 1920, 1080, pixels=2.0)
    path = RECORDED / f"scene_{name}.npz"
    return recorded(path) if path.is_file() else procedural({"2k": 2_000, "10k": 10_000}[name], 270, 480, pixels=3.0)


def recorded(path: Path) -> Scene:
    arrays = np.load(path)
    gaussians = [torch.from_numpy(arrays[k]) for k in ("means", "quats", "scales", "opacities", "sh")]
    view, K, v_image = (torch.from_numpy(arrays[k])[None] for k in ("viewmat", "K", "v_image"))
    return Scene(*gaussians, view, K, int(arrays["W"]), int(arrays["H"]), v_image, f"recorded scene {path.name}")


def split(whole: Scene, parts: int) -> Scene:
    """Every Gaussian becomes `parts` smaller ones, their centres drawn from it."""
    generator = torch.Generator().manual_seed(0)
    rows = torch.arange(len(whole.means)).repeat_interleave(parts)
    scales = whole.scales[rows]
    offsets = torch.randn(scales.shape, generator=generator) * scales
    return Scene(
        means=whole.means[rows] + torch.einsum("nij,nj->ni", _rotations(whole.quats[rows]), offsets),
        quats=whole.quats[rows],
        scales=scales / SPLIT_SHRINK,
        opacities=whole.opacities[rows],
        sh_coeffs=whole.sh_coeffs[rows],
        viewmats=whole.viewmats,
        Ks=whole.Ks,
        width=whole.width,
        height=whole.height,
        v_image=whole.v_image,
        source=f"{whole.source}, each Gaussian split in {parts}",
    )


def procedural(
    n: int,
    width: int,
    height: int,
    *,
    pixels: float,  # median standard deviation as seen
) -> Scene:
    """Gaussians in front of a camera, sizes and opacities spread as in a trained scene."""
    rng = torch.Generator().manual_seed(0)
    focal = FOCAL_SHARE * height
    depth = 1 + 5 * torch.rand(n, generator=rng)
    x = (torch.rand(n, generator=rng) - 0.5) * 1.1 * width / focal * depth
    y = (torch.rand(n, generator=rng) - 0.5) * 1.1 * height / focal * depth
    seen = pixels * torch.exp(0.7 * torch.randn(n, 3, generator=rng))
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Scene(
        means=torch.stack([x, y, depth], -1),
        quats=torch.randn(n, 4, generator=rng),
        scales=seen * depth[:, None] / focal,
        opacities=torch.rand(n, generator=rng) ** 0.7,
        sh_coeffs=0.3 * torch.randn(n, 16, 3, generator=rng),
        viewmats=torch.eye(4)[None],
        Ks=K[None],
        width=width,
        height=height,
        v_image=torch.randn(1, height, width, 3, generator=rng),
        source=f"procedural scene, seed 0, {n} Gaussians",
    )


def _rotations(quats: Tensor) -> Tensor:  # [N, 4] -> [N, 3, 3]
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rows = (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack(rows, dim=-1).reshape(-1, 3, 3)
