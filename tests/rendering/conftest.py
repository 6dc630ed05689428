"""Fixtures of the rasterizer's tests."""

import pytest
import torch
import warp as wp


@pytest.fixture(autouse=True)
def one_torch_thread():
    """The twin's tensors are small: on a busy machine torch's threads wait for each other most of the time."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(params=["pixels", "tiles", "gpu"])
def shape(request, device, monkeypatch) -> str:
    """Every kernel shape that the device runs, in float32."""
    if request.param == "tiles" and device != "cpu":
        pytest.skip("the shape 'tiles' is the CPU's")
    if request.param == "gpu" and device == "cpu":
        monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)
    return request.param
