"""The GPU's shape behind `rasterize`: several renders before a backward pass, and a step that is repeated for room."""

import pytest
import torch
import warp as wp

from graphgs.rendering import IntersectionOverflow, rasterize
from graphgs.training.config import TrainConfig
from graphgs.training.trainer import Trainer
from tests.support.gaussians import make_scene
from tests.support.tiny_scene import tiny_scene


@pytest.fixture
def blocks(monkeypatch):
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)


def test_two_renders_may_come_before_their_backward_passes(blocks):
    scenes = make_scene(60, 50, 37, seed=3), make_scene(40, 33, 37, seed=5)

    def gradients(shape: str) -> list[torch.Tensor]:
        leaves = [scene.leaves(torch.float32) for scene in scenes]
        outs = [
            scene.render(rasterize, leaf, shape=shape, median_depth=True)
            for scene, leaf in zip(scenes, leaves, strict=True)
        ]
        sum((out.colors**2).sum() + out.depths.sum() + out.median_depths.sum() for out in outs).backward()
        return [tensor.grad for leaf in leaves for tensor in leaf.values()]

    for got, want in zip(gradients("gpu"), gradients("tiles"), strict=True):
        assert (got - want).norm() < 1e-5 * want.norm()


def test_a_step_without_room_is_repeated(tmp_path, monkeypatch):
    tiny = tiny_scene(tmp_path)
    config = TrainConfig(steps=20, consistency="none")

    def losses(fail_at: int | None) -> list[float]:
        trainer = Trainer(config, tiny.views, tiny.graph, tiny.truth, extent=1.0, device="cpu", seed=0)
        gradients, failed = trainer._gradients, []

        def sometimes(step: int):
            if step == fail_at and not failed:
                failed.append(step)
                gradients(step)  # leaves gradients behind, as a backward pass that stops half-way may
                raise IntersectionOverflow(2, 1)
            return gradients(step)

        monkeypatch.setattr(trainer, "_gradients", sometimes)
        try:
            found = [float(trainer.step()) for _ in range(6)]
        finally:
            trainer.close()
        assert failed == ([] if fail_at is None else [fail_at])
        return found

    assert losses(3) == losses(None)
