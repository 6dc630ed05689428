"""`rasterize`: the gradient of what it computes, real scenes against an oracle, and what densification relies on."""

import numpy as np
import pytest
import torch

import graphgs.threads
from graphgs.rendering import rasterize
from tests.support.agreement import VALUES, cotangents, distance, pull_back
from tests.support.edge_cases import edge_case_scenes
from tests.support.gaussians import make_scene

GRADCHECKED = [
    "sh 3 of 3, two cameras",
    "32 channels",
    "masked",
    "median depth",
    "antialiased",
    "more in a tile than a batch",
    "behind the camera",
    "equal depths",
    "saturated",
    "empty tiles",
]


@pytest.mark.parametrize("name", GRADCHECKED)
def test_gradcheck_in_float64(name):
    scene = edge_case_scenes()[name]
    leaves = scene.leaves(torch.float64)
    # A step that parts two equal depths exchanges two Gaussians, and the image jumps: no derivative there.
    fixed = ("means", "viewmats") if name == "equal depths" else ()
    moving = [key for key in leaves if key not in fixed]

    def function(*values):
        out = scene.render(rasterize, {**leaves, **dict(zip(moving, values, strict=True))})
        return tuple(value for key in VALUES if (value := getattr(out, key)) is not None)

    assert torch.autograd.gradcheck(
        function, [leaves[key] for key in moving], eps=1e-8, atol=1e-4, rtol=1e-3, fast_mode=True
    )


@pytest.mark.parametrize("scene_name", ["2k", "10k"])
def test_a_real_scene_equals_the_oracle(scene_name, shared_data):
    folder = shared_data("raster")
    scene, oracle = np.load(folder / f"scene_{scene_name}.npz"), np.load(folder / f"oracle_{scene_name}.npz")
    keys = ("means", "quats", "scales", "opacities", "sh")
    leaves = [torch.from_numpy(scene[key]).requires_grad_() for key in keys]
    view, K = torch.from_numpy(scene["viewmat"])[None], torch.from_numpy(scene["K"])[None]
    out = rasterize(*leaves, view, K, int(scene["W"]), int(scene["H"]), sh_degree=3)
    (out.colors[0] * torch.from_numpy(scene["v_image"])).sum().backward()
    assert distance(out.colors[0], torch.from_numpy(oracle["image"])) < 1e-4
    for key, leaf in zip(keys, leaves, strict=True):  # the oracle is float32 itself
        assert distance(leaf.grad, torch.from_numpy(oracle[f"g_{key}"])) < 2e-4, key


def test_same_bits_for_any_number_of_threads(monkeypatch):
    scene = make_scene(400, 150, 90, cameras=2, sh_coeffs=16, sh_degree=3, median_depth=True, absgrad=True, seed=11)
    results = []
    for threads in (1, 2, 3):
        monkeypatch.setattr(graphgs.threads, "_num_threads", threads)
        leaves = scene.leaves(torch.float32)
        out = scene.render(rasterize, leaves)
        gradients = pull_back(out, cotangents(out), leaves)
        results.append([*(getattr(out, key).detach() for key in VALUES), *gradients.values(), out.means2d.absgrad])
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_screen_positions_carry_a_gradient_for_densification():
    scene = make_scene(30, absgrad=True)
    out = scene.render(rasterize, scene.leaves(torch.float32))
    out.means2d.retain_grad()
    out.colors.sum().backward()
    assert out.means2d.grad.shape == out.means2d.absgrad.shape == (1, 30, 2)
    visible = (out.radii > 0).all(dim=-1)
    assert visible.any()
    assert (out.means2d.grad[visible].abs().sum(-1) > 0).any()
    assert (out.means2d.grad[~visible] == 0).all()
    # What pixels disagree about cancels in the one, and adds up in the other.
    assert (out.means2d.absgrad >= out.means2d.grad.abs() * (1 - 1e-5)).all()
    assert (out.means2d.absgrad > 1.5 * out.means2d.grad.abs())[visible].any()


def test_gradients_flow_from_depth_alone():
    scene = make_scene(30)
    leaves = scene.leaves(torch.float32)
    scene.render(rasterize, leaves).depths.sum().backward()
    assert all(leaves[key].grad.abs().sum() > 0 for key in ("means", "quats", "scales", "opacities", "viewmats", "Ks"))


def test_only_what_is_asked_for_gets_a_gradient():
    scene = make_scene(30)
    for name in scene.FLOATS:
        leaves = {key: leaf.detach() for key, leaf in scene.leaves(torch.float32).items()}
        leaves[name].requires_grad_()
        scene.render(rasterize, leaves).colors.sum().backward()
        assert leaves[name].grad.abs().sum() > 0, name


def test_a_render_keeps_its_gradient_while_others_are_made(shape, device):
    """Memory that kernels keep between steps is not a render's own."""
    scenes = [make_scene(20, 16, 16, seed=22), make_scene(60, 33, 17, cameras=2, seed=23), make_scene(0)]
    alone, together = [], []
    for scene in scenes:
        leaves = scene.leaves(torch.float32, device)
        out = scene.render(rasterize, leaves, shape=shape)
        alone.append(pull_back(out, cotangents(out), leaves))
    leaves = [scene.leaves(torch.float32, device) for scene in scenes]
    outputs = [scene.render(rasterize, operands, shape=shape) for scene, operands in zip(scenes, leaves, strict=True)]
    for out, operands in zip(outputs, leaves, strict=True):
        together.append(pull_back(out, cotangents(out), operands))
    for one, other in zip(alone, together, strict=True):
        assert all(distance(other[name], one[name]) < 1e-5 for name in one)  # the order of atomics may differ
