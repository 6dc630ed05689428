"""What is left out of the loss: what hangs together and fits badly, and never more than allowed."""

import torch

from graphgs.training.robust import LEAST_ERROR, PATCH, fitting_pixels

H, W = 60, 80


def _photo() -> torch.Tensor:
    return torch.rand(1, H, W, 3, generator=torch.Generator().manual_seed(0)) * 0.2 + 0.4


def test_a_passer_by_is_left_out_and_fine_texture_is_not():
    scene = _photo()
    photo = scene.clone()
    photo[:, 20:40, 30:44] = 1.0
    colors = scene.clone()
    colors[:, ::9, ::9] += 0.3  # single pixels, as of texture that is not learned yet
    kept = fitting_pixels(colors, photo, None, share=0.1)[0, :, :, 0].bool()
    assert not kept[22:38, 32:42].any()
    outside = torch.ones(H, W, dtype=torch.bool)
    outside[20 - PATCH : 40 + PATCH, 30 - PATCH : 44 + PATCH] = False
    assert kept[outside].all()


def test_never_more_than_the_share_and_nothing_that_fits():
    photo = _photo()
    wrong = 1.0 - photo
    assert (fitting_pixels(wrong, photo, None, share=0.1) == 0).float().mean() <= 0.1
    assert fitting_pixels(photo + 0.9 * LEAST_ERROR, photo, None, share=0.1).all()
    assert fitting_pixels(wrong, photo, None, share=0.0).all()


def test_what_a_mask_leaves_out_stays_out_and_decides_nothing():
    photo = _photo()
    mask = torch.ones(1, H, W, 1)
    mask[:, :20] = 0.0
    wild = photo.clone()
    wild[:, :20] = 9.0
    plain, other = (fitting_pixels(colors, photo, mask, share=0.2) for colors in (photo, wild))
    assert torch.equal(plain, other)
    assert torch.equal(plain, mask)
