"""SSIM and the photometric loss against their float64 twins."""

import pytest
import torch

import graphgs.threads
from graphgs.losses import photometric_loss, ssim
from tests.support.reference import ssim as twin

# height, width: smaller than the window; odd; more than one block of 80 px with a rest; several blocks
SIZES = [(3, 4), (17, 23), (13, 97), (12, 241)]


def images(cameras, height, width, *, dtype=torch.float32, device="cpu", seed=0):
    generator = torch.Generator().manual_seed(seed)
    truth = torch.rand(cameras, height, width, 3, generator=generator, dtype=torch.float64)
    image = truth + 0.2 * torch.randn(truth.shape, generator=generator, dtype=torch.float64)
    return image.clamp(0, 1).to(device, dtype), truth.to(device, dtype)


def relative(a, b):
    return float((a.double().cpu() - b).norm() / b.norm())


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_ssim_and_its_gradients_agree_with_the_twin(height, width, device):
    a, b = (t.requires_grad_() for t in images(2, height, width, device=device))
    a64, b64 = (t.detach().double().cpu().requires_grad_() for t in (a, b))
    value, expected = ssim(a, b), twin.ssim_map(a64, b64).mean()
    value.backward()
    expected.backward()
    # float32: the variances are differences of numbers near 0.3, rounded at 1e-7, beside C2 = 9e-4
    assert value.dtype == torch.float32
    assert float(value.detach()) == pytest.approx(float(expected.detach()), abs=1e-5)
    assert relative(a.grad, a64.grad) < 1e-5
    assert relative(b.grad, b64.grad) < 1e-5


def test_ssim_in_float64_passes_gradcheck(device):
    a, b = (t.requires_grad_() for t in images(2, 7, 9, dtype=torch.float64, device=device))
    a64, b64 = (t.detach().cpu() for t in (a, b))
    assert float(ssim(a, b).detach()) == pytest.approx(float(twin.ssim_map(a64, b64).mean()), abs=1e-14)
    assert torch.autograd.gradcheck(ssim, (a, b))


def test_ssim_of_equal_images_is_one_and_symmetric(device):
    a, b = images(1, 20, 30, device=device)
    assert float(ssim(a, a)) == pytest.approx(1.0, abs=1e-6)
    assert float(ssim(a, b)) == pytest.approx(float(ssim(b, a)), abs=1e-7)


def masked_case(device, dtype=torch.float32):
    image, truth = images(2, 19, 95, dtype=dtype, device=device)
    mask = torch.rand(2, 19, 95, generator=torch.Generator().manual_seed(1)).to(device) > 0.3
    return image, truth, mask


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_photometric_loss_agrees_with_the_twin(dtype, device):
    image, truth, mask = masked_case(device, dtype)
    image.requires_grad_()
    image64 = image.detach().double().cpu().requires_grad_()
    loss = photometric_loss(image, truth, mask, ssim_weight=0.3)
    expected = twin.photometric_loss(image64, truth.double().cpu(), mask.cpu(), 0.3)
    loss.backward()
    expected.backward()
    tolerance = 1e-5 if dtype == torch.float32 else 1e-13
    assert float(loss.detach()) == pytest.approx(float(expected.detach()), abs=tolerance)
    assert relative(image.grad, image64.grad) < tolerance


def test_masked_pixels_have_no_gradient_and_no_influence(device):
    image, truth, mask = masked_case(device)
    spoiled = torch.where(mask[..., None], image, torch.full_like(image, float("nan")))
    results = []
    for given in (image, spoiled):
        leaf = given.clone().requires_grad_()
        loss = photometric_loss(leaf, truth, mask)
        loss.backward()
        assert torch.all(leaf.grad[~mask] == 0)
        results.append((loss.detach(), leaf.grad))
    assert torch.equal(results[0][0], results[1][0])
    assert torch.equal(results[0][1], results[1][1])


def test_mask_and_truth_may_come_in_several_forms(device):
    image, truth, mask = masked_case(device)
    photo = (truth * 255).round().to(torch.uint8)
    loss = photometric_loss(image, photo, mask)
    assert torch.equal(loss, photometric_loss(image, photo.float() / 255, mask[..., None]))
    assert torch.equal(loss, photometric_loss(image, photo, 255 * mask.to(torch.uint8)))
    everything = torch.ones_like(mask)
    assert torch.equal(photometric_loss(image, photo), photometric_loss(image, photo, everything))


def test_nothing_kept_gives_zero_loss_and_gradient(device):
    image, truth, mask = masked_case(device)
    image.requires_grad_()
    loss = photometric_loss(image, truth, torch.zeros_like(mask))
    loss.backward()
    assert float(loss.detach()) == 0.0
    assert torch.all(image.grad == 0)


def test_the_result_does_not_depend_on_the_number_of_threads(monkeypatch):
    results = []
    for threads in (1, 2, 3):
        monkeypatch.setattr(graphgs.threads, "_num_threads", threads)
        image, truth, mask = images(1, 61, 100)[0].requires_grad_(), images(1, 61, 100)[1], None
        loss = photometric_loss(image, truth, mask)
        loss.backward()
        results.append((loss.detach(), image.grad))
    assert all(torch.equal(loss, results[0][0]) and torch.equal(v, results[0][1]) for loss, v in results)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((torch.rand(8, 8, 3), torch.rand(8, 8, 3)), r"a: expected \[C, H, W, 3\], got \[8, 8, 3\]"),
        ((torch.rand(1, 8, 8, 3), torch.rand(1, 8, 9, 3)), r"b: expected \[1, 8, 8, 3\] like a"),
        ((torch.rand(1, 8, 8, 3).half(), torch.rand(1, 8, 8, 3)), "a: expected float32 or float64"),
        ((torch.rand(1, 8, 8, 3), torch.rand(1, 8, 8, 3).double()), "b: expected torch.float32 on cpu like a"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        ssim(*arguments)


def test_a_mask_of_another_size_is_refused():
    image, truth = images(1, 8, 8)
    with pytest.raises(ValueError, match=r"mask: expected \[1, 8, 8, 1\]"):
        photometric_loss(image, truth, torch.ones(1, 8, 9))
