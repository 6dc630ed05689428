"""A tile that very many Gaussians meet: lists far longer than a batch, walked to their end."""

from dataclasses import replace

import pytest
import torch

from tests.support.agreement import compare, expect
from tests.support.gaussians import Scene, make_scene


def crowded(n: int, reach: float) -> Scene:
    """`n` Gaussians smaller than a pixel in one tile, with opacities up to `reach` / 255: each is seen by so few pixels
    that no pixel's light runs out, and the whole list is walked."""
    return make_scene(n, 16, 16, scale=(1e-4, 1e-3), opacity=(1 / 255, reach / 255), seed=31)


def check(scene: Scene, shape: str, device: str, pixels: torch.Tensor) -> None:
    """Against the twin at some of the pixels, as it takes every Gaussian to each; it leaves the others out."""
    expected = expect(replace(scene, masks=pixels), where=pixels)
    output = expected.output
    assert float(output.walked[pixels].double().mean()) > 20
    assert float(output.alphas[pixels].max()) < 0.999  # no pixel has stopped
    assert float(output.doubtful[pixels].double().mean()) < 0.5
    agreement = compare(scene, expected, shape=shape, dtype=torch.float32, device=device)
    assert agreement.misses() == []


def every(step: int) -> torch.Tensor:  # [1, 16, 16] bool
    return (torch.arange(256) % step == 0).view(1, 16, 16)


def test_twenty_thousand_in_a_tile(shape, device):
    check(crowded(20_000, 3.0), shape, device, every(2))


@pytest.mark.slow
def test_a_million_in_a_tile(shape, device):
    check(crowded(1_000_000, 1.1), shape, device, every(31))
