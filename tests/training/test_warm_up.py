"""Reduced photos and cameras agree with full ones."""

import dataclasses

import pytest
import torch

from graphgs.rendering.splats import TENSORS, Splats, render
from graphgs.training import train
from graphgs.training.config import TrainConfig
from graphgs.training.schedule import Schedule
from graphgs.training.warm_up import LEAST_SIDE, reduce_camera, reduce_photo, reduction_of
from tests.support.tiny_scene import COUNT, tiny_scene

K = torch.tensor([[[50.0, 0.0, 23.0], [0.0, 60.0, 18.0], [0.0, 0.0, 1.0]]])


def test_a_quarter_then_half_then_the_whole():
    schedule = Schedule(TrainConfig(steps=100, warm_up_fraction=0.4))
    assert [schedule.reduction(step) for step in (0, 19, 20, 39, 40, 99)] == [4, 4, 2, 2, 1, 1]
    assert {Schedule(TrainConfig(steps=100)).reduction(step) for step in range(100)} == {1}


def test_the_consistency_term_waits_for_the_whole_size():
    config = TrainConfig(steps=100, warm_up_fraction=0.5, consistency_from_fraction=0.0, consistency_interval=1)
    first = next(step for step in range(100) if Schedule(config).has_consistency(step))
    assert first == 50


@pytest.mark.parametrize(("side", "expected"), [(4 * LEAST_SIDE, 4), (4 * LEAST_SIDE - 1, 2), (2 * LEAST_SIDE - 1, 1)])
def test_small_photos_are_reduced_less(side, expected):
    assert reduction_of(1000, side, 4) == reduction_of(side, 1000, 4) == expected


def test_means_of_whole_blocks_and_only_whole_masks():
    photo = torch.arange(2 * 5 * 3, dtype=torch.float32).reshape(1, 2, 5, 3)
    mask = torch.ones(1, 2, 5, 1)
    mask[0, 1, 2] = 0.0
    small, kept = reduce_photo(photo, mask, 2)
    assert small.shape == (1, 1, 2, 3)
    torch.testing.assert_close(small[0, 0, 0], (photo[0, 0, 0] + photo[0, 0, 1] + photo[0, 1, 0] + photo[0, 1, 1]) / 4)
    assert kept[0, 0, :, 0].tolist() == [1.0, 0.0]
    assert reduce_photo(photo, mask, 1) == (photo, mask)


def test_a_point_keeps_its_place():
    """The mean of the pixels that a Gaussian covers stays where it was, in units of the photo's size."""
    splats = Splats(
        means=torch.tensor([[0.1, -0.05, 1.0]]),
        quats=torch.tensor([[1.0, 0, 0, 0]]),
        log_scales=torch.full((1, 3), -2.5),  # 4 px
        logit_opacities=torch.tensor([0.0]),
        sh_coeffs=torch.zeros(1, 16, 3),
    )

    def centroid(K, width, height):
        weights = render(splats, K[0], torch.eye(4), width, height).alphas[0, ..., 0]
        columns = torch.arange(width) + 0.5
        rows = torch.arange(height) + 0.5
        return torch.stack([(weights.sum(0) * columns).sum(), (weights.sum(1) * rows).sum()]) / weights.sum()

    full = centroid(K, 48, 36)
    small = centroid(*reduce_camera(K, 48, 36, 2))
    torch.testing.assert_close(small * 2, full, rtol=0, atol=0.02)  # px; half a pixel would be the usual mistake


def test_a_resumed_warm_up_repeats_every_bit(tmp_path_factory, tmp_path):
    scene = tiny_scene(tmp_path_factory.mktemp("scene"))
    config = TrainConfig(steps=30, max_splats=COUNT, warm_up_fraction=0.8, consistency="none")

    def run(folder, config=config, **options):
        return train(config, scene.views, scene.graph, scene.points, scratch=tmp_path / folder, threads=1, **options)

    whole = run("whole").splats
    for stop in (6, 17, 25):
        run("parts", stop_at=stop)
    parts = run("parts").splats
    assert all(torch.equal(getattr(whole, name), getattr(parts, name)) for name in TENSORS)
    cold = run("cold", dataclasses.replace(config, warm_up_fraction=0.0)).splats
    assert not torch.equal(whole.means, cold.means)
