"""`rasterize`, in both kernel shapes, against the float64 twin and against the oracle of real scenes."""

import numpy as np
import pytest
import torch

import graphgs.threads
from graphgs.rendering import rasterize
from tests.support.gaussians import edge_case_scenes, make_scene
from tests.support.reference.rasterize import rasterize as twin

SCENES = edge_case_scenes()
OUTPUTS = ("colors", "alphas", "depths")


def relative(a: torch.Tensor, b: torch.Tensor) -> float:
    """Relative L2 distance; absolute where the reference is 0."""
    a, b = a.detach().double().cpu(), b.detach().double().cpu()
    return float((a - b).norm() / max(float(b.norm()), 1e-6))


def cotangents(scene) -> list[torch.Tensor]:
    rng = torch.Generator().manual_seed(99)
    size = (len(scene.viewmats), scene.height, scene.width)
    return [torch.randn(*size, d, generator=rng, dtype=torch.float64) for d in (3, 1, 1)]


def pull_back(outputs, v_outputs, leaves) -> dict[str, torch.Tensor]:
    loss = sum((o * v.to(o)).sum() for o, v in zip(outputs, v_outputs, strict=True))
    loss.backward()
    return {k: torch.zeros_like(v) if v.grad is None else v.grad for k, v in leaves.items()}


@pytest.mark.parametrize(("dtype", "shape"), [("float64", "pixels"), ("float32", "pixels"), ("float32", "tiles")])
@pytest.mark.parametrize("name", SCENES)
def test_values_and_gradients_equal_the_twin(name, dtype, shape, device):
    if shape == "tiles" and device != "cpu":
        pytest.skip("the tile shape is the CPU's")
    # float32 rounds at 6e-8; the sums over pixels and the inverse of a thin covariance amplify that about 1000 times.
    tolerance = 1e-9 if dtype == "float64" else 2e-4
    scene = SCENES[name]
    v_outputs = cotangents(scene)
    expected_leaves = scene.leaves(torch.float64)
    expected = scene.render(twin, expected_leaves)
    v_expected = pull_back(expected, v_outputs, expected_leaves)

    leaves = scene.leaves(getattr(torch, dtype), device)
    out = scene.render(rasterize, leaves, shape=shape)
    outputs = [getattr(out, key) for key in OUTPUTS]
    for key, got, want in zip(OUTPUTS, outputs, expected, strict=True):
        assert got.shape == want.shape
        assert relative(got, want) < tolerance, key
    for key, got in pull_back(outputs, v_outputs, leaves).items():
        assert relative(got, v_expected[key]) < tolerance, key


GRADCHECKED = [
    "sh 3 of 3, two cameras",
    "antialiased",
    "more in a tile than a batch",
    "behind the camera",
    "equal depths",
    "saturated",
    "empty tiles",
]


@pytest.mark.parametrize("name", GRADCHECKED)
def test_gradcheck_in_float64(name):
    scene = SCENES[name]
    leaves = scene.leaves(torch.float64)
    # A step that parts two equal depths exchanges two Gaussians, and the image jumps: no derivative there.
    fixed = ("means", "viewmats") if name == "equal depths" else ()
    moving = [key for key in leaves if key not in fixed]

    def function(*values):
        out = scene.render(rasterize, {**leaves, **dict(zip(moving, values, strict=True))})
        return out.colors, out.alphas, out.depths

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
    assert relative(out.colors[0], torch.from_numpy(oracle["image"])) < 1e-4
    for key, leaf in zip(keys, leaves, strict=True):
        assert relative(leaf.grad, torch.from_numpy(oracle[f"g_{key}"])) < 2e-4, key


def test_same_bits_for_any_number_of_threads(monkeypatch):
    scene = make_scene(400, 150, 90, cameras=2, sh_coeffs=16, sh_degree=3, seed=11)
    results = []
    for threads in (1, 2, 3):
        monkeypatch.setattr(graphgs.threads, "_num_threads", threads)
        leaves = scene.leaves(torch.float32)
        out = scene.render(rasterize, leaves)
        outputs = [getattr(out, key) for key in OUTPUTS]
        gradients = pull_back(outputs, cotangents(scene), leaves)
        results.append([*(o.detach() for o in outputs), *gradients.values()])
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_equal_depths_are_drawn_in_the_order_of_their_index():
    scene = make_scene(2, 16, 16, background=False)
    leaves = scene.leaves(torch.float32)
    for key in ("means", "viewmats"):
        leaves[key] = torch.tensor([[0.0, 0, 3]] * 2) if key == "means" else torch.eye(4)[None]
    leaves |= {"scales": torch.ones(2, 3), "opacities": torch.tensor([0.99, 0.99]), "colors": torch.eye(3)[:2]}
    for shape in ("pixels", "tiles"):
        center = scene.render(rasterize, leaves, shape=shape).colors[0, 8, 8]
        assert center[0] > 0.9 > 0.1 > center[1] > 0


def test_screen_positions_carry_a_gradient_for_densification():
    scene = make_scene(30)
    out = scene.render(rasterize, scene.leaves(torch.float32))
    out.means2d.retain_grad()
    out.colors.sum().backward()
    assert out.means2d.grad.shape == (1, 30, 2)
    visible = (out.radii > 0).all(dim=-1)
    assert visible.any()
    assert (out.means2d.grad[visible].abs().sum(-1) > 0).any()
    assert (out.means2d.grad[~visible] == 0).all()


def test_gradients_flow_from_depth_alone():
    scene = make_scene(30)
    leaves = scene.leaves(torch.float32)
    scene.render(rasterize, leaves).depths.sum().backward()
    assert all(leaves[key].grad.abs().sum() > 0 for key in ("means", "quats", "scales", "opacities", "viewmats"))


WRONG = {
    "quats: expected [30, 4], got [30, 3]": {"quats": torch.ones(30, 3)},
    "scales: expected [30, 3], got [29, 3]": {"scales": torch.ones(29, 3)},
    "opacities: expected [30], got [30, 1]": {"opacities": torch.ones(30, 1)},
    "viewmats: expected [1, 4, 4], got [1, 3, 4]": {"viewmats": torch.ones(1, 3, 4)},
    "backgrounds: expected [1, 3], got [2, 3]": {"backgrounds": torch.ones(2, 3)},
    "colors: expected torch.float32 as means, got torch.float64": {"colors": torch.ones(30, 3).double()},
    "means: expected float32 or float64, got torch.float16": {"means": torch.ones(30, 3).half()},
}


@pytest.mark.parametrize("message", WRONG)
def test_wrong_operands_are_named(message):
    scene = make_scene(30)
    leaves = scene.leaves(torch.float32) | WRONG[message]
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the whole message is compared
        scene.render(rasterize, leaves)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    "options", [{"near": 0.0}, {"near": 2.0, "far": 1.0}, {"eps2d": -1.0}, {"sh_degree": 3}, {"sh_degree": 4}]
)
def test_wrong_options_are_refused(options):
    scene = make_scene(3)
    with pytest.raises(ValueError, match="expected"):
        scene.render(rasterize, scene.leaves(torch.float32), **options)
