"""Fixtures of the rasterizer's tests."""

import pytest
import warp as wp


@pytest.fixture(params=["pixels", "tiles", "gpu"])
def shape(request, device, monkeypatch) -> str:
    """Every kernel shape that the device runs, in float32."""
    if request.param == "tiles" and device != "cpu":
        pytest.skip("the shape 'tiles' is the CPU's")
    if request.param == "gpu" and device == "cpu":
        monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)
    return request.param
