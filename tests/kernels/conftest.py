"""Fixtures of the kernels' tests."""

import pytest
import warp as wp


@pytest.fixture
def cpu_blocks():
    """Kernels of blocks run on the CPU as well, with every thread of a block."""
    before = wp.config.enable_cpu_blocks
    wp.config.enable_cpu_blocks = True
    yield
    wp.config.enable_cpu_blocks = before
