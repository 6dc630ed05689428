"""Small seeded sets of projected splats, and compositing them by a kernel shape or by the reference."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
import warp as wp

from graphgs.kernels.rasterize.buffers import Frame, Image, Splats
from tests.support.reference.composite import composite

VALUES = ("colors", "alphas", "depths", "median_depths")
GRADIENTS = ("means2d", "conics", "depths", "opacities", "colors", "abs_means2d")


@dataclass(frozen=True)
class SplatScene:
    """Arrays are float64 or int32, [C, N, ...]; pixels are [C, H * W, ...]."""

    splats: dict[str, np.ndarray]  # means2d, conics, depths, opacities, colors
    radii: np.ndarray  # [C, N, 2]
    backgrounds: np.ndarray  # [C, D]
    masks: np.ndarray | None  # [C, H * W] bool
    cotangents: dict[str, np.ndarray]  # of VALUES, [C, H * W, ...]
    width: int
    height: int


def make_splats(
    n: int,
    width: int = 33,
    height: int = 17,
    *,
    cameras: int = 1,
    channels: int = 3,
    sigma: tuple[float, float] = (0.7, 6.0),  # [px]
    opacity: tuple[float, float] = (0.05, 0.95),
    equal_depths: bool = False,
    masked: bool = False,
    seed: int = 0,
) -> SplatScene:
    rng = np.random.default_rng(seed)
    size = (cameras, n)
    axes = np.exp(rng.uniform(*np.log(sigma), (*size, 2)))
    angle = rng.uniform(0, np.pi, size)
    cos, sin = np.cos(angle), np.sin(angle)
    covariance_x = cos**2 * axes[..., 0] ** 2 + sin**2 * axes[..., 1] ** 2
    covariance_y = sin**2 * axes[..., 0] ** 2 + cos**2 * axes[..., 1] ** 2
    off = cos * sin * (axes[..., 0] ** -2.0 - axes[..., 1] ** -2.0)
    determinant = (axes[..., 0] * axes[..., 1]) ** 2
    radii = np.ceil(3.33 * np.sqrt(np.stack([covariance_x, covariance_y], -1))).astype(np.int32)
    radii[:, 4::9] = 0  # not visible
    pixels = (cameras, width * height)
    return SplatScene(
        splats={
            "means2d": rng.uniform((-3, -3), (width + 3, height + 3), (*size, 2)),
            "conics": np.stack([covariance_y / determinant, off, covariance_x / determinant], -1),
            "depths": np.full(size, 2.0) if equal_depths else rng.uniform(1, 9, size),
            "opacities": rng.uniform(*opacity, size),
            "colors": rng.uniform(0, 1, (*size, channels)),
        },
        radii=radii,
        backgrounds=rng.uniform(0, 1, (cameras, channels)),
        masks=rng.uniform(size=pixels) < 0.7 if masked else None,
        cotangents={
            "colors": rng.normal(size=(*pixels, channels)),
            **{name: rng.normal(size=pixels) for name in VALUES[1:]},
        },
        width=width,
        height=height,
    )


def composite_by_reference(scene: SplatScene) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Values by name, and gradients by name."""
    leaves = {name: torch.from_numpy(array).requires_grad_() for name, array in scene.splats.items()}
    size = scene.width * scene.height
    cameras = len(scene.radii)
    masks = np.ones((cameras, size), bool) if scene.masks is None else scene.masks
    copies = leaves["means2d"][:, None].expand(-1, size, -1, -1).clone()
    copies.retain_grad()
    out = composite(
        **leaves | {"means2d": copies},
        backgrounds=torch.from_numpy(scene.backgrounds),
        visible=torch.from_numpy(scene.radii[..., 0] > 0),
        masks=torch.from_numpy(masks),
        width=scene.width,
    )
    values = {name: getattr(out, name) for name in VALUES}
    if leaves["depths"].numel():
        sum((values[name] * torch.from_numpy(v)).sum() for name, v in scene.cotangents.items()).backward()
    gradients = {
        name: np.zeros(leaf.shape) if leaf.grad is None else leaf.grad.numpy() for name, leaf in leaves.items()
    }
    gradients["abs_means2d"] = (
        np.zeros_like(scene.splats["means2d"]) if copies.grad is None else copies.grad.abs().sum(1).numpy()
    )
    return {name: value.detach().numpy() for name, value in values.items()}, gradients


def composite_by_kernels(
    scene: SplatScene,
    forward: Callable,
    backward: Callable,
    *,
    real=wp.float32,
    device: str = "cpu",
    features: bool = True,  # median depths and absolute gradients
    **options,  # of `forward`
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """The same, by the launchers of a kernel shape."""
    channels = scene.backgrounds.shape[-1]
    types = {"means2d": 2, "abs_means2d": 2, "conics": 3, "colors": channels}

    def upload(array: np.ndarray, name: str = "") -> wp.array:
        flat = array.reshape(-1, *array.shape[2:]) if name in types else array.reshape(-1)
        dtype = wp.types.vector(types[name], real) if name in types else real
        return wp.array(flat, dtype=dtype, device=device)

    def like(arrays: dict[str, np.ndarray]) -> dict[str, wp.array]:
        return {name: upload(np.zeros_like(array), name) for name, array in arrays.items()}

    cameras = len(scene.radii)
    splats = Splats(**{name: upload(array, name) for name, array in scene.splats.items()})
    masks = None if scene.masks is None else wp.array(scene.masks.reshape(-1).astype(np.uint8), device=device)
    backgrounds = wp.array(scene.backgrounds, dtype=wp.types.vector(channels, real), device=device)
    frame = Frame(cameras, scene.width, scene.height, backgrounds, masks)
    unwanted = set() if features else {"median_depths", "abs_means2d"}
    pixels = {name: array for name, array in scene.cotangents.items() if name not in unwanted}
    image = Image(**like(pixels))
    radii = wp.array(scene.radii.reshape(-1, 2), dtype=wp.vec2i, device=device)
    state = forward(splats, radii, frame, image, **options)
    wanted = {name: array for name, array in scene.splats.items()}
    if features:
        wanted["abs_means2d"] = scene.splats["means2d"]
    v_splats = Splats(**like(wanted))
    v_image = Image(**{name: upload(array, name) for name, array in pixels.items()})
    backward(splats, frame, state, v_image, v_splats)
    values = {name: getattr(image, name).numpy().reshape(scene.cotangents[name].shape) for name in pixels}
    gradients = {name: getattr(v_splats, name).numpy().reshape(array.shape) for name, array in wanted.items()}
    return values, gradients
