"""Photos reach the loss in the drawn order, within the budget."""

import dataclasses

import cv2
import numpy as np
import pytest
import torch

from graphgs.training.images import TrainingImages
from tests.support.tiny_scene import HEIGHT, WIDTH, tiny_scene


@pytest.mark.parametrize("budget_bytes", [1, 5 * HEIGHT * WIDTH, 2**20])
def test_the_photo_of_a_step_is_that_of_its_view(tmp_path, budget_bytes, device):
    views = tiny_scene(tmp_path).views
    order = [3, 1, 3, 7, 5]
    images = TrainingImages(views, budget_bytes=budget_bytes, view_of_step=lambda s: order[s % 5], device=device)
    try:
        for step in (0, 1, 2, 4, 3):  # also out of order: a resumed run starts anywhere
            view, photo, mask = images.of_step(step)
            assert view == order[step]
            assert mask is None
            expected = torch.from_numpy(views.read(view)[0]).float()[None] / 255
            assert torch.equal(photo.cpu(), expected)
            assert torch.equal(images.of_view(view)[0], photo)
    finally:
        images.close()


def test_masks_arrive_as_weights(tmp_path):
    views = tiny_scene(tmp_path).views
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[:, : WIDTH // 2] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    views = dataclasses.replace(views, masks=("mask.png",) * len(views.names))
    images = TrainingImages(views, budget_bytes=2**20, view_of_step=lambda s: 1, device="cpu")
    try:
        _, _, weights = images.of_step(0)
        assert weights.shape == (1, HEIGHT, WIDTH, 1)
        assert weights.sum() == HEIGHT * (WIDTH // 2)
    finally:
        images.close()
