"""What breaks rasterizers, by name: every kernel shape against the float64 twin, and finite for whatever is finite."""

from dataclasses import replace
from itertools import product

import pytest
import torch

from graphgs.rendering import rasterize
from tests.support.agreement import compare, cotangents, expect, pull_back, rendered
from tests.support.edge_cases import edge_case_scenes
from tests.support.gaussians import make_scene

SCENES = edge_case_scenes()


@pytest.mark.parametrize("name", SCENES)
def test_values_and_gradients_equal_the_twin(name, shape, device):
    scene = SCENES[name]
    agreement = compare(scene, expect(scene), shape=shape, dtype=torch.float32, device=device)
    assert agreement.misses() == []
    assert agreement.differing <= agreement.doubtful


@pytest.mark.parametrize("name", SCENES)
def test_float64_equals_the_twin_closely(name, device):
    scene = SCENES[name]
    agreement = compare(scene, expect(scene), shape="pixels", dtype=torch.float64, device=device)
    assert agreement.misses() == []


# From the smallest float32 to the largest; also what is outside an operand's range, such as opacity -1.
EXTREMES = [0.0, -1.0, 1e-45, 1e-38, 1e-20, -1e-20, 1e10, -1e10, 1e19, 1e25, -1e25, 3.4e38, -3.4e38]


@pytest.mark.parametrize("extreme", EXTREMES)
def test_extreme_operands_leave_everything_finite(extreme, shape, device):
    """One Gaussian in three is extreme in one operand, along one axis or all of them; or the camera's pose is."""
    names = ["means", "quats", "scales", "opacities", "viewmats"]
    names += ["colors"] if abs(extreme) <= 1e25 else []  # sums of the largest colours have no float32
    scene = make_scene(12, 16, 16, seed=21)
    for name, axes, antialiased in product(names, (slice(0, 1), slice(None)), (False, True)):
        values = getattr(scene, name).clone()
        values.view(12 if len(values) == 12 else 4, -1)[::3, axes] = extreme
        odd = replace(scene, **{name: values}, options={"antialiased": antialiased})
        leaves = odd.leaves(torch.float32, device)
        out = odd.render(rasterize, leaves, shape=shape)
        for key, tensor in (rendered(out) | pull_back(out, cotangents(out), leaves)).items():
            assert tensor.isfinite().all(), f"{key}, for extreme {name}, {axes}, antialiased={antialiased}"


def test_equal_depths_are_drawn_in_the_order_of_their_index(shape, device):
    scene = make_scene(2, 16, 16, background=False)
    leaves = scene.leaves(torch.float32, device)
    same = {
        "means": torch.tensor([[0.0, 0, 3]] * 2),
        "viewmats": torch.eye(4)[None],
        "scales": torch.ones(2, 3),
        "opacities": torch.tensor([0.99, 0.99]),
        "colors": torch.eye(3)[:2],
    }
    leaves |= {name: tensor.to(device) for name, tensor in same.items()}
    center = scene.render(rasterize, leaves, shape=shape).colors[0, 8, 8]
    assert center[0] > 0.9 > 0.1 > center[1] > 0


def test_a_gaussian_at_the_camera_is_not_drawn_and_gets_no_gradient(shape, device):
    scene = SCENES["at the camera's centre"]
    leaves = scene.leaves(torch.float32, device)
    out = scene.render(rasterize, leaves, shape=shape)
    gradients = pull_back(out, cotangents(out), leaves)
    assert (out.radii[:, ::4] == 0).all()
    for name in ("means", "quats", "scales", "opacities", "colors"):
        assert (gradients[f"v_{name}"][::4] == 0).all(), name


def test_nothing_to_see_shows_the_background(shape, device):
    for name in ("nothing visible", "nothing at all", "all masked", "opacity 0"):
        scene = SCENES[name]
        out = scene.render(rasterize, scene.leaves(torch.float32, device), shape=shape)
        assert torch.equal(out.colors.cpu(), scene.backgrounds.float()[:, None, None].expand_as(out.colors)), name
        assert not out.alphas.any(), name
        assert not out.depths.any(), name


def test_light_never_falls_below_the_stop(shape, device):
    out = SCENES["saturated"].render(rasterize, SCENES["saturated"].leaves(torch.float32, device), shape=shape)
    assert 0.99 < float(out.alphas.detach().max()) < 1 - 0.99e-4
