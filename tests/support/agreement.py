"""How far a rendering and its gradients are from the float64 twin, and how far they may be."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from graphgs.rendering import rasterize
from tests.support.gaussians import Scene
from tests.support.reference.rasterize import Twin
from tests.support.reference.rasterize import rasterize as twin

VALUES = ("colors", "alphas", "depths", "median_depths")

# Relative L2 distances. float32 rounds at 6e-8, and where parts cancel (light taken away splat by splat, shares of
# pixels that push a centre to and fro, the inverse of a thin covariance) up to a thousand times more is left.
VALUE_BOUND = 1e-4
GRADIENT_BOUND = 1e-3
TIGHT_GRADIENTS = {"v_means": 1e-4, "v_colors": 1e-4}  # what training leans on
COSINE_BOUND = 0.9999
DOUBLE_BOUND = 1e-9  # float64 rounds at 1e-16


@dataclass(frozen=True)
class Expected:
    """The twin's rendering of a scene, and the gradients by the cotangents that come with it."""

    output: Twin
    compared: Tensor  # [C, H, W] bool: pixels that count and are not doubtful
    v_outputs: dict[str, Tensor]  # float64, 0 where nothing is compared
    gradients: dict[str, Tensor]  # `v_` plus the operand; and of the projected centres


@dataclass(frozen=True)
class Agreement:
    """Of one scene rendered by the kernels with the twin."""

    dtype: torch.dtype
    errors: dict[str, float]  # relative L2 distances, of images where they are compared
    cosines: dict[str, float]  # of the gradients that are not 0
    finite: bool
    pixels: int
    doubtful: int  # pixels so near a threshold that single precision may decide otherwise
    differing: int  # pixels, of all, that show a decision taken otherwise

    def misses(self) -> list[str]:
        """What lies outside its bound, in words; none if all is well."""
        missed = [] if self.finite else ["not finite"]
        for name, error in self.errors.items():
            if not error <= self._bound(name):
                missed.append(f"{name}: relative distance {error:.1e}, bound {self._bound(name):.0e}")
        for name, cosine in self.cosines.items():
            if not cosine >= COSINE_BOUND:
                missed.append(f"{name}: cosine {cosine:.6f}, bound {COSINE_BOUND}")
        return missed

    def _bound(self, name: str) -> float:
        if self.dtype == torch.float64:
            return DOUBLE_BOUND
        return VALUE_BOUND if name in VALUES else TIGHT_GRADIENTS.get(name, GRADIENT_BOUND)


def expect(
    scene: Scene,
    where: Tensor | None = None,  # [C, H, W] bool: the pixels that count; None is all
) -> Expected:
    """The truth, with random cotangents at the pixels that count and are not doubtful."""
    leaves = scene.leaves(torch.float64)
    output = scene.render(twin, leaves)
    compared = ~output.doubtful if where is None else ~output.doubtful & where
    v_outputs = {name: compared[..., None] * v for name, v in cotangents(output).items()}
    gradients = pull_back(output, v_outputs, leaves)
    if output.shares:
        gradients |= {"v_means2d": output.v_means2d(), "absgrad": output.absgrad()}
    # Without the graph and the shares, which are large.
    detached = {name: value.detach() for name, value in rendered(output).items()}
    return Expected(replace(output, **detached, shares=[]), compared, v_outputs, gradients)


def compare(scene: Scene, expected: Expected, *, shape: str | None, dtype: torch.dtype, device: str) -> Agreement:
    """Render the scene with the kernels, and hold values and gradients against the twin's."""
    leaves = scene.leaves(dtype, device)
    output = scene.render(rasterize, leaves, shape=shape)
    output.means2d.retain_grad()
    gradients = pull_back(output, expected.v_outputs, leaves)
    if "absgrad" in expected.gradients:
        gradients |= {"v_means2d": output.means2d.grad, "absgrad": output.means2d.absgrad}

    values, wanted = rendered(output), rendered(expected.output)
    assert {k: v.shape for k, v in values.items()} == {k: v.shape for k, v in wanted.items()}
    assert {k: v.shape for k, v in gradients.items()} == {k: v.shape for k, v in expected.gradients.items()}
    where, doubtful = expected.compared, expected.output.doubtful
    errors = {name: distance(value.cpu()[where], wanted[name][where]) for name, value in values.items()}
    errors |= {name: distance(gradients[name], want) for name, want in expected.gradients.items()}
    return Agreement(
        dtype=dtype,
        errors=errors,
        cosines={name: cosine(gradients[name], want) for name, want in expected.gradients.items() if want.any()},
        finite=all(bool(t.isfinite().all()) for t in (*values.values(), *gradients.values())),
        pixels=doubtful.numel(),
        doubtful=int(doubtful.sum()),
        differing=int(_differs(values, wanted).sum()),
    )


def rendered(output) -> dict[str, Tensor]:
    """What a render, or its twin, shows, by name."""
    return {name: value for name in VALUES if (value := getattr(output, name)) is not None}


def cotangents(output) -> dict[str, Tensor]:
    """A fixed random one for each of the rendered images, float64 on the CPU."""
    rng = torch.Generator().manual_seed(99)
    return {k: torch.randn(v.shape, generator=rng, dtype=torch.float64) for k, v in rendered(output).items()}


def pull_back(output, v_outputs: dict[str, Tensor], leaves: dict[str, Tensor]) -> dict[str, Tensor]:
    """The gradients of the differentiable leaves, each named `v_` plus the leaf."""
    values = rendered(output)
    loss = sum((values[name] * v.to(values[name])).sum() for name, v in v_outputs.items())
    loss.backward()
    return {
        f"v_{name}": torch.zeros_like(leaf) if leaf.grad is None else leaf.grad
        for name, leaf in leaves.items()
        if leaf.requires_grad
    }


def distance(found: Tensor, wanted: Tensor) -> float:
    """Relative L2 distance; absolute where the reference is 0."""
    found, wanted = found.detach().double().cpu(), wanted.detach().double().cpu()
    norm = float(wanted.norm())
    return float((found - wanted).norm()) / (norm if norm > 0 else 1.0)


def cosine(found: Tensor, wanted: Tensor) -> float:
    found, wanted = found.double().cpu().flatten(), wanted.double().cpu().flatten()
    return float((found / found.norm().clamp(min=1e-300)) @ (wanted / wanted.norm()))


def _differs(found: dict[str, Tensor], wanted: dict[str, Tensor]) -> Tensor:  # [C, H, W]
    """Where a pixel took other Gaussians: rounding alone moves alpha, or the median's depth, by less."""

    def gap(name: str) -> Tensor:
        return (found[name].detach().double().cpu() - wanted[name].detach()).abs()

    differs = gap("alphas") > 1e-4
    if "median_depths" in wanted:
        differs = differs | (gap("median_depths") > 1e-4 * wanted["median_depths"])
    return differs.squeeze(-1)
