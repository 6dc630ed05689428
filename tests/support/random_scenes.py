"""Scenes drawn over every feature of the rasterizer: `random_scene(seed)` is the same scene for the same seed."""

import math
import random

import torch
from torch import Tensor

from tests.support.gaussians import Scene

CHANNELS = (1, 2, 3, 4, 7, 16, 32)
KINDS = ("ordinary", "flat", "needle", "huge", "sub-pixel", "faint", "opaque", "behind", "outside")
SIZES = ((1, 1), (7, 5), (16, 16), (17, 33), (33, 17), (48, 1), (40, 30), (64, 48), (63, 47))


class Draw:
    """Random numbers of one seed, float64 with the precision of float32: both precisions then see the same scene."""

    def __init__(self, seed: int):
        self.choices = random.Random(seed)
        self.numbers = torch.Generator().manual_seed(seed)

    def chance(self, probability: float) -> bool:
        return self.choices.random() < probability

    def choice(self, options):
        return self.choices.choice(options)

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        unit = torch.rand(shape, generator=self.numbers, dtype=torch.float64)
        return (low + (high - low) * unit).float().double()

    def between(self, low: float, high: float, *shape: int) -> Tensor:
        """Uniform in the logarithm."""
        return self.uniform(math.log(low), math.log(high), *shape).exp().float().double()


def random_scene(seed: int) -> Scene:
    """A scene of up to 120 Gaussians, three cameras, and 64 x 48 px."""
    draw = Draw(seed)
    width, height = draw.choice(SIZES)
    cameras = draw.choice((1, 1, 2, 3))
    n = draw.choice((0, 1, 5, 20, 60, 120))
    focal = float(draw.between(0.5, 2.0)) * max(width, height)

    kinds = draw.choices.sample(KINDS, draw.choices.randint(1, len(KINDS)))
    means, scales, opacities = _gaussians(draw, n, kinds, width, height, focal)
    viewmats, means = _place(draw, cameras, means)
    colors, options = _colors(draw, n)
    channels = colors.shape[-1]
    options |= {"eps2d": draw.choice((0.3, 0.3, 0.1, 1.0)), "near": draw.choice((0.01, 0.01, 1.0))}
    options |= {"antialiased": draw.chance(0.3), "median_depth": draw.chance(0.4), "absgrad": draw.chance(0.4)}
    if draw.chance(0.2):
        options["far"] = 5.0
    return Scene(
        means=means,
        quats=draw.uniform(-1, 1, n, 4) * draw.between(0.3, 3, n, 1),
        scales=scales,
        opacities=opacities,
        colors=colors,
        viewmats=viewmats,
        Ks=_intrinsics(draw, cameras, width, height, focal),
        width=width,
        height=height,
        options=options,
        backgrounds=draw.uniform(0, 1, cameras, channels) if draw.chance(0.6) else None,
        masks=draw.uniform(0, 1, cameras, height, width) < 0.8 if draw.chance(0.3) else None,
        fixed=tuple(name for name in ("viewmats", "Ks") if draw.chance(0.4)),
    ).rounded()


def _gaussians(
    draw: Draw, n: int, kinds: list[str], width: int, height: int, focal: float
) -> tuple[Tensor, Tensor, Tensor]:  # [N, 3] in the first camera, [N, 3], [N]
    kind = [draw.choice(kinds) for _ in range(n)]

    def of(*names: str) -> Tensor:  # [N] bool
        return torch.tensor([k in names for k in kind], dtype=torch.bool)

    z = draw.uniform(1.5, 6.0, n)
    spread = torch.where(of("outside"), 4.0, 1.2)
    x = draw.uniform(-0.5, 0.5, n) * spread * width / focal * z
    y = draw.uniform(-0.5, 0.5, n) * spread * height / focal * z
    means = torch.stack([x, y, torch.where(of("behind"), -z, z)], -1)

    pixel = (z / focal)[:, None]  # world size of a pixel at the Gaussian's depth
    image = min(width, height)
    scales = draw.between(0.5, max(1.0, 0.2 * image), n, 3) * pixel
    scales = torch.where(of("huge")[:, None], draw.between(0.5, 5.0, n, 3) * image * pixel, scales)
    scales = torch.where(of("sub-pixel")[:, None], draw.between(0.01, 0.5, n, 3) * pixel, scales)
    thin = torch.where(of("flat", "needle"), 0.01, 1.0)
    scales = scales * torch.stack([torch.ones_like(z), torch.where(of("needle"), 0.01, 1.0), thin], -1)

    opacities = draw.uniform(0.05, 0.95, n)
    opacities = torch.where(of("faint"), draw.uniform(0.0, 0.02, n), opacities)
    opacities = torch.where(of("opaque"), draw.choice((1.0, 0.999)), opacities)
    return means, scales, opacities


def _place(
    draw: Draw,
    cameras: int,
    means: Tensor,  # [N, 3] in the first camera
) -> tuple[Tensor, Tensor]:  # viewmats [C, 4, 4], means [N, 3] in the world
    """The first camera anywhere in the world, the others near it."""
    cam_from_world = torch.eye(4, dtype=torch.float64).repeat(cameras, 1, 1)
    cam_from_world[:, :3, :3] = _rotation(draw.uniform(-2, 2, 3))
    cam_from_world[:, :3, 3] = draw.uniform(-1, 1, 3)
    means = (means - cam_from_world[0, :3, 3]) @ cam_from_world[0, :3, :3]
    for c in range(1, cameras):
        nearby = torch.eye(4, dtype=torch.float64)
        nearby[:3, :3] = _rotation(draw.uniform(-0.1, 0.1, 3))
        nearby[:3, 3] = draw.uniform(-0.2, 0.2, 3)
        cam_from_world[c] = nearby @ cam_from_world[c]
    return cam_from_world, means


def _colors(draw: Draw, n: int) -> tuple[Tensor, dict]:
    """Plain colours of any number of channels, or spherical harmonics, often of a higher degree than is used."""
    if draw.chance(0.5):
        return draw.uniform(0, 1, n, draw.choice(CHANNELS)), {}
    degree = draw.choice((0, 1, 2, 3))
    stored = draw.choice((degree, 3))
    return draw.uniform(-0.5, 0.5, n, (stored + 1) ** 2, 3), {"sh_degree": degree}


def _intrinsics(draw: Draw, cameras: int, width: int, height: int, focal: float) -> Tensor:  # [C, 3, 3]
    K = torch.eye(3, dtype=torch.float64).repeat(cameras, 1, 1)
    K[:, 0, 0] = focal * draw.uniform(0.95, 1.05, cameras)
    K[:, 1, 1] = focal * draw.uniform(0.85, 1.15, cameras)
    K[:, 0, 2] = width * draw.uniform(0.4, 0.6, cameras)
    K[:, 1, 2] = height * draw.uniform(0.4, 0.6, cameras)
    return K


def _rotation(axis_angle: Tensor) -> Tensor:  # [3] -> [3, 3]
    x, y, z = axis_angle.tolist()
    return torch.linalg.matrix_exp(torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64))
