"""What `rasterize` refuses, and that it names the argument, what it expected and what it got."""

import re

import pytest
import torch
from torch import Tensor

from graphgs.rendering import rasterize
from tests.support.agreement import cotangents, pull_back, rendered
from tests.support.gaussians import make_scene

SCENE = make_scene(30)


def refused(**changed) -> str:
    """The message of the ValueError that the scene raises with these arguments instead of its own."""
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the tests compare the message
        SCENE.render(rasterize, SCENE.leaves(torch.float32) | changed)
    return str(caught.value)


WRONG = {
    "quats: expected [30, 4], got [30, 3]": {"quats": torch.ones(30, 3)},
    "scales: expected [30, 3], got [29, 3]": {"scales": torch.ones(29, 3)},
    "opacities: expected [30], got [30, 1]": {"opacities": torch.ones(30, 1)},
    "viewmats: expected [1, 4, 4], got [1, 3, 4]": {"viewmats": torch.ones(1, 3, 4)},
    "Ks: expected [1, 3, 3], got [3, 3]": {"Ks": torch.eye(3)},
    "backgrounds: expected [1, 3], got [2, 3]": {"backgrounds": torch.ones(2, 3)},
    "masks: expected [1, 23, 37], got [1, 37, 23]": {"masks": torch.ones(1, 37, 23, dtype=torch.bool)},
    "masks: expected torch.bool, got torch.float32": {"masks": torch.ones(1, 23, 37)},
    "masks: expected torch.bool, got torch.uint8": {"masks": torch.ones(1, 23, 37, dtype=torch.uint8)},
    "colors: expected torch.float32 as means, got torch.float64": {"colors": torch.ones(30, 3).double()},
    "scales: expected torch.float32 as means, got torch.int32": {"scales": torch.ones(30, 3, dtype=torch.int32)},
    "means: expected float32 or float64, got torch.float16": {"means": torch.ones(30, 3).half()},
    "means: expected float32 or float64, got torch.int64": {"means": torch.ones(30, 3, dtype=torch.int64)},
    "colors: expected [30, D] with D in 1 to 32, got [30, 0]": {"colors": torch.ones(30, 0), "backgrounds": None},
    "colors: expected [30, D] with D in 1 to 32, got [30, 33]": {"colors": torch.ones(30, 33), "backgrounds": None},
    "Ks: expected positive focal lengths, got 0": {"Ks": torch.zeros(1, 3, 3)},
    "viewmats: expected at least one camera, got none": {
        "viewmats": torch.ones(0, 4, 4),
        "Ks": torch.ones(0, 3, 3),
        "backgrounds": None,
    },
}


@pytest.mark.parametrize("message", WRONG)
def test_wrong_operands_are_named(message):
    assert refused(**WRONG[message]) == message


FLOATS = ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks", "backgrounds")


@pytest.mark.parametrize("name", FLOATS)
def test_what_is_no_tensor_is_named(name):
    assert re.fullmatch(rf"{name}: expected .*, got .*", refused(**{name: [[1.0]]}))


@pytest.mark.parametrize("name", FLOATS[1:])
def test_another_device_is_named(name):
    elsewhere = SCENE.leaves(torch.float32)[name].to("meta")
    assert refused(**{name: elsewhere}) == f"{name}: expected device cpu as means, got meta"


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("name", FLOATS)
def test_what_is_not_finite_is_named(name, value):
    tensor = SCENE.leaves(torch.float32)[name].detach().clone()
    tensor.view(-1)[-1] = value
    assert re.fullmatch(rf"{name}: expected .*finite.*, got 1 .*", refused(**{name: tensor}))


def test_opposite_infinities_are_found_as_well():
    tensor = SCENE.leaves(torch.float32)["scales"].detach().clone()
    tensor[0, 0], tensor[1, 1] = float("inf"), -float("inf")
    assert "got 2" in refused(scales=tensor)


def test_large_values_whose_sum_overflows_are_accepted():
    colors = torch.full((30, 3), 3e38)
    SCENE.render(rasterize, SCENE.leaves(torch.float32) | {"colors": colors})


def test_unvalidated_skips_the_look_for_nan_alone():
    leaves = SCENE.leaves(torch.float32)
    leaves["colors"] = torch.full((30, 3), float("nan"))
    assert SCENE.render(rasterize, leaves, validate=False).colors.isnan().any()
    leaves["colors"] = torch.ones(29, 3)
    with pytest.raises(ValueError, match="colors: expected"):
        SCENE.render(rasterize, leaves, validate=False)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("near", {"near": 0.0}),
        ("near", {"near": 2.0, "far": 1.0}),
        ("near", {"near": float("nan")}),
        ("eps2d", {"eps2d": -1.0}),
        ("eps2d", {"eps2d": float("nan")}),
        ("sh_degree", {"sh_degree": 4}),
        ("sh_degree", {"sh_degree": -1}),
        ("colors", {"sh_degree": 3}),
        ("shape", {"shape": "other"}),
        ("width", {"width": 0}),
        ("width", {"width": -5}),
        ("height", {"height": -5}),
    ],
)
def test_wrong_options_are_refused(name, options):
    arguments = SCENE.leaves(torch.float32) | {"width": SCENE.width, "height": SCENE.height} | options
    with pytest.raises(ValueError, match=rf"\b{name}\b.*: .*expect.* got "):
        rasterize(**arguments)


def test_integers_cannot_ask_for_a_gradient():
    """torch itself does not let an integer tensor require one; a tensor made of integers is refused by its type."""
    with pytest.raises(RuntimeError, match="floating point"):
        torch.ones(30, 3, dtype=torch.int64).requires_grad_()
    assert "torch.int64" in refused(opacities=torch.ones(30, dtype=torch.int64))


def strided(tensor: Tensor) -> Tensor:
    """The same values, every second one of a tensor twice as long."""
    return tensor.repeat_interleave(2, dim=0)[::2]


@pytest.mark.parametrize(("dtype", "shape"), [("float32", "pixels"), ("float32", "tiles"), ("float64", "pixels")])
def test_strides_do_not_matter(dtype, shape):
    scene = make_scene(30, cameras=2, sh_coeffs=4, sh_degree=1)
    masks = torch.arange(2 * 23 * 37).view(2, 23, 37) % 5 > 0
    results = []
    for view in (lambda tensor: tensor, strided):
        leaves = scene.leaves(getattr(torch, dtype))
        operands = {name: view(leaf) for name, leaf in leaves.items()}
        if view is strided:
            assert not any(operand.is_contiguous() for operand in operands.values())
        output = scene.render(rasterize, operands, masks=view(masks), shape=shape)
        # Cotangents come as torch likes, and need not be contiguous either.
        v_outputs = {name: view(v.to(output.colors)) for name, v in cotangents(output).items()}
        results.append((rendered(output), pull_back(output, v_outputs, leaves)))
    for one, other in zip(*results, strict=True):
        assert all(torch.equal(one[name], other[name]) for name in one)


def test_an_expanded_tensor_is_read_as_it_shows():
    leaves = SCENE.leaves(torch.float32)
    gray = leaves | {"colors": torch.full((30, 1), 0.5).expand(30, 3)}
    solid = leaves | {"colors": torch.full((30, 3), 0.5)}
    assert torch.equal(SCENE.render(rasterize, gray).colors, SCENE.render(rasterize, solid).colors)
