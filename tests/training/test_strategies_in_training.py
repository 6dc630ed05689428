"""Every strategy and option at work in whole runs: the limit holds, and a resumed run repeats every bit."""

import dataclasses

import pytest
import torch

from graphgs.rendering.splats import TENSORS
from graphgs.training import train
from graphgs.training.config import TrainConfig
from tests.support.tiny_scene import COUNT, tiny_scene

SHORT = TrainConfig(
    steps=40,
    max_splats=COUNT + 20,
    consistency="none",
    densify_from_step=8,
    densify_from_fraction=1.0,
    densify_until_fraction=0.75,
    densify_interval=8,
    densify_gradient=1e-5,
    densify_absgrad=4e-5,
    mcmc_growth=0.2,
)
CHOICES = {
    "default": {},
    "3dgs": {"absgrad": False, "revised_opacity": False},
    "regularised": {"opacity_reg": 0.01, "scale_reg": 0.01},
    "mcmc": {"strategy": "mcmc"},
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return tiny_scene(tmp_path_factory.mktemp("scene"))


def _train(scene, scratch, choice, **options):
    config = dataclasses.replace(SHORT, **CHOICES[choice])
    return train(config, scene.views, scene.graph, scene.points, scratch=scratch, seed=3, threads=1, **options)


@pytest.mark.parametrize("choice", CHOICES)
def test_a_resumed_run_repeats_every_bit_within_the_limit(scene, tmp_path, choice):
    whole = _train(scene, tmp_path / "whole", choice)
    for stop in (9, 17, 30):
        _train(scene, tmp_path / "parts", choice, stop_at=stop)
    parts = _train(scene, tmp_path / "parts", choice)
    assert all(torch.equal(getattr(whole.splats, name), getattr(parts.splats, name)) for name in TENSORS)
    counts = [entry["num_splats"] for entry in whole.stats.curve]
    assert max(counts) == len(whole.splats) == SHORT.max_splats


def test_choices_differ(scene, tmp_path):
    means = [_train(scene, tmp_path / choice, choice).splats.means for choice in CHOICES]
    assert not any(torch.equal(means[0], other) for other in means[1:])
