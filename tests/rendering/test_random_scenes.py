"""Every kernel shape against the float64 twin, over random scenes of every feature.

Forty scenes in the ordinary suite; all five hundred, with the worst of each quantity printed, by `pytest -m slow -s`.
"""

from collections.abc import Iterable
from functools import cache

import pytest
import torch

from tests.support.agreement import Agreement, Expected, compare, expect
from tests.support.gaussians import Scene
from tests.support.random_scenes import CHANNELS, random_scene

ORDINARY, ALL = range(40), range(500)
DIFFERING = 1e-3  # share of pixels that may show a threshold decided otherwise than in float64


@cache
def case(seed: int) -> tuple[Scene, Expected]:
    scene = random_scene(seed)
    return scene, expect(scene)


def survey(seeds: Iterable[int], *, shape: str, device: str, dtype: torch.dtype = torch.float32) -> str:
    """Hold all scenes within their bounds, together; a table of the worst."""
    found = {}
    for seed in seeds:
        scene, expected = case(seed)
        found[seed] = compare(scene, expected, shape=shape, dtype=dtype, device=device)
    missed = [f"seed {seed}: {miss}" for seed, agreement in found.items() for miss in agreement.misses()]
    assert not missed, "\n".join(missed)
    pixels = sum(agreement.pixels for agreement in found.values())
    assert sum(agreement.differing for agreement in found.values()) <= DIFFERING * pixels
    assert sum(agreement.doubtful for agreement in found.values()) <= DIFFERING * pixels
    return worst(found)


def worst(found: dict[int, Agreement]) -> str:
    pixels = sum(agreement.pixels for agreement in found.values())
    doubtful = sum(agreement.doubtful for agreement in found.values())
    differing = sum(agreement.differing for agreement in found.values())
    lines = [f"{len(found)} scenes, {pixels} pixels: {doubtful} doubtful, {differing} decided otherwise"]
    names = dict.fromkeys(name for agreement in found.values() for name in agreement.errors)
    for name in names:
        seed = max(found, key=lambda seed: found[seed].errors.get(name, -1.0))
        cosines = [agreement.cosines[name] for agreement in found.values() if name in agreement.cosines]
        cosine = f", smallest cosine 1 - {1 - min(cosines):.0e}" if cosines else ""
        lines.append(f"{name:>14}: {found[seed].errors[name]:.1e} (seed {seed}){cosine}")
    return "\n".join(lines)


def test_forty_scenes_equal_the_twin(shape, device):
    survey(ORDINARY, shape=shape, device=device)


def test_forty_scenes_in_float64_equal_the_twin(device):
    survey(ORDINARY, shape="pixels", device=device, dtype=torch.float64)


@pytest.mark.slow
def test_five_hundred_scenes_equal_the_twin(shape, device, capsys):
    table = survey(ALL, shape=shape, device=device)
    with capsys.disabled():
        print(f"\n{shape} on {device}: {table}")


def test_the_scenes_hold_every_feature():
    scenes = [random_scene(seed) for seed in ORDINARY]
    options = [scene.options for scene in scenes]
    assert {o.get("sh_degree") for o in options} == {None, 0, 1, 2, 3}
    assert {s.colors.shape[-1] for s in scenes if s.colors.dim() == 2} == set(CHANNELS)
    assert {len(s.viewmats) for s in scenes} == {1, 2, 3}
    assert {len(s.means) for s in scenes} >= {0, 1, 120}
    for name in ("antialiased", "median_depth", "absgrad"):
        assert {o[name] for o in options} == {False, True}, name
    for name in ("backgrounds", "masks"):
        assert {getattr(s, name) is None for s in scenes} == {False, True}, name
    for name in ("viewmats", "Ks"):
        assert {name in s.fixed for s in scenes} == {False, True}, name
    assert any((o.get("sh_degree", 3) + 1) ** 2 < s.colors.shape[1] for o, s in zip(options, scenes, strict=True))
