"""Fixtures every room shares."""

from pathlib import Path

import pytest
import warp as wp

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def _devices() -> list[str]:
    return ["cpu", "cuda:0"] if wp.is_cuda_available() else ["cpu"]


@pytest.fixture(params=_devices())
def device(request) -> str:
    """Every device kernels can run on here: the CPU, and CUDA where there is one."""
    return request.param


@pytest.fixture
def shared_data():
    """Folder of a real photo set by name. The sets are not part of the project: without them the test is skipped."""

    def find(name: str) -> Path:
        folder = SHARED_DATA / name
        if not folder.is_dir():
            pytest.skip(f"real photo set '{name}' is not on this machine (looked in {SHARED_DATA})")
        return folder

    return find
