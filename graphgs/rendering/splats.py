"""The scene: 3D Gaussians before their activations."""

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from graphgs.errors import DataError
from graphgs.points import PrunedPoints
from graphgs.rendering.rasterize import RenderOutput, rasterize

NEAR = 0.01  # camera z, world units: the near plane of scenes that name none
DARKEST = 1.0 / 255.0  # initial colour: at 0, where colours are clamped, a Gaussian has no gradient and stays black
SH_C0 = 0.28209479177387814  # the constant spherical harmonic, 1 / (2 sqrt(pi))
TENSORS = ("means", "quats", "log_scales", "logit_opacities", "sh_coeffs")


@dataclass(frozen=True)
class Splats:
    """Trained (or initial) Gaussians, float32, one row each. `sh_degree` is the highest degree that is rendered."""

    means: Tensor  # [N, 3] world
    quats: Tensor  # [N, 4] wxyz, need not be unit
    log_scales: Tensor  # [N, 3] log of the standard deviations in world units
    logit_opacities: Tensor  # [N] before the sigmoid
    sh_coeffs: Tensor  # [N, 16, 3]; colour = SH + 0.5, clamped at 0
    sh_degree: int = 3
    near: float = NEAR  # camera z below which the scene holds no surface and nothing is drawn, world units

    def __post_init__(self):
        n = self.means.shape[0]
        for name, shape in (
            ("means", (n, 3)),
            ("quats", (n, 4)),
            ("log_scales", (n, 3)),
            ("logit_opacities", (n,)),
            ("sh_coeffs", (n, 16, 3)),
        ):
            if tuple(getattr(self, name).shape) != shape:
                raise ValueError(f"{name}: expected {list(shape)}, got {list(getattr(self, name).shape)}")
        if not 0 <= self.sh_degree <= 3:
            raise ValueError(f"sh_degree: expected 0 to 3, got {self.sh_degree}")
        if not 0.0 < self.near < math.inf:
            raise ValueError(f"near: expected a positive number, got {self.near}")

    def __len__(self) -> int:
        return self.means.shape[0]

    @property
    def scales(self) -> Tensor:
        """[N, 3] standard deviations, world units."""
        return torch.exp(self.log_scales)

    @property
    def opacities(self) -> Tensor:
        """[N] in 0..1."""
        return torch.sigmoid(self.logit_opacities)

    @property
    def is_finite(self) -> bool:
        return all(bool(torch.isfinite(getattr(self, name)).all()) for name in TENSORS)

    def to(self, device: str | torch.device) -> "Splats":
        return replace(self, **{name: getattr(self, name).to(device) for name in TENSORS})

    def rows(self, index: Tensor) -> "Splats":  # [M] int64 or [N] bool
        return replace(self, **{name: getattr(self, name)[index] for name in TENSORS})

    def save(self, folder: Path) -> None:
        """Write splats.safetensors and splats.json."""
        folder.mkdir(parents=True, exist_ok=True)
        save_file({n: getattr(self, n).detach().cpu().contiguous() for n in TENSORS}, folder / "splats.safetensors")
        header = {"count": len(self), "sh_degree": self.sh_degree, "near": self.near}
        (folder / "splats.json").write_text(json.dumps(header, indent=1))

    @staticmethod
    def load(folder: Path) -> "Splats":
        header = json.loads((folder / "splats.json").read_text())
        tensors = load_file(folder / "splats.safetensors")
        return Splats(**tensors, sh_degree=int(header["sh_degree"]), near=float(header["near"]))

    @staticmethod
    def from_points(
        points: PrunedPoints,
        *,
        initial_opacity: float = 0.1,  # 3DGS, Kerbl et al. 2023
        device: str | torch.device = "cpu",
    ) -> "Splats":
        """Round Gaussians at the points: size `points.scales`, colour in the constant harmonic. Raises DataError
        when there is no point to start from."""
        count = len(points.positions)
        if count == 0:
            raise DataError(
                "training: there are no 3D points to start from",
                hint="the reconstruction found no point that several photos share; add photos with more overlap",
            )
        colors = np.asarray(points.colors)
        colors = colors.astype(np.float32) / 255.0 if colors.dtype == np.uint8 else colors.astype(np.float32)
        sh_coeffs = torch.zeros(count, 16, 3)
        sh_coeffs[:, 0] = (torch.from_numpy(colors).clamp(min=DARKEST) - 0.5) / SH_C0
        log_scales = np.log(np.maximum(np.asarray(points.scales, dtype=np.float64), 1e-12)).astype(np.float32)
        quats = torch.zeros(count, 4)
        quats[:, 0] = 1.0
        return Splats(
            means=torch.from_numpy(np.array(points.positions, dtype=np.float32)),
            quats=quats,
            log_scales=torch.from_numpy(log_scales)[:, None].repeat(1, 3),
            logit_opacities=torch.full((count,), float(np.log(initial_opacity / (1.0 - initial_opacity)))),
            sh_coeffs=sh_coeffs,
        ).to(device)


def render(
    splats: Splats,
    K: np.ndarray | Tensor,  # [3, 3] px
    viewmat: np.ndarray | Tensor,  # [4, 4] world-to-camera
    width: int,
    height: int,
    *,
    sh_degree: int | None = None,  # None = splats.sh_degree
    antialiased: bool = False,
) -> RenderOutput:
    """One view of the scene on black; differentiable in the splats."""
    device = splats.means.device
    return rasterize(
        splats.means,
        splats.quats,
        splats.scales,
        splats.opacities,
        splats.sh_coeffs,
        torch.as_tensor(viewmat, dtype=torch.float32, device=device)[None],
        torch.as_tensor(K, dtype=torch.float32, device=device)[None],
        width,
        height,
        sh_degree=splats.sh_degree if sh_degree is None else sh_degree,
        near=splats.near,
        antialiased=antialiased,
    )
