"""A long run holds no more memory than a short one."""

import gc
from pathlib import Path

import pytest

from graphgs.training import train
from graphgs.training.config import TrainConfig
from tests.support.tiny_scene import tiny_scene

STEPS, SLICE = 20_000, 4_000
ALLOWED_MB = 8.0  # of growth in 16,000 steps: half a kilobyte a step would show


def _resident_mb() -> float:
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="resident size is read from /proc")
def test_memory_is_flat_over_20000_steps(tmp_path):
    scene = tiny_scene(tmp_path)
    config = TrainConfig(steps=STEPS, max_splats=120, checkpoint_s=1e9)
    sizes = []
    for stop in range(SLICE, STEPS + 1, SLICE):
        trained = train(config, scene.views, scene.graph, scene.points, scratch=tmp_path / "s", threads=1, stop_at=stop)
        assert trained.stats.steps_executed == stop
        assert trained.stats.num_splats <= 120
        del trained
        sizes.append(_resident_mb())
    print("resident MB:", [round(size, 1) for size in sizes])
    assert sizes[-1] - sizes[0] < ALLOWED_MB
