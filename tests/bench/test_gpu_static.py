"""Every kernel that a GPU runs compiles for seven architectures, without a GPU, and obeys the rules of a training step.

The first run compiles for most of a minute; Warp keeps the result until a kernel changes.
"""

from pathlib import Path

import pytest

from bench.gpu_kernels import ARCHITECTURES, KERNELS, LOCAL_ARRAYS, LOW_OCCUPANCY
from bench.gpu_static import compile_all, cuobjdump
from bench.occupancy import occupancy

TRAINING = [name for name, entry in KERNELS.items() if entry.training_step]
DOCS = Path(__file__).parents[2] / "docs" / "kernels.md"


@pytest.fixture(scope="module")
def usages():
    tool = cuobjdump()
    if tool is None:
        pytest.skip("the wheel nvidia-cuda-cuobjdump is not installed")
    return compile_all(tool)


def test_every_kernel_compiles_for_every_architecture(usages):
    assert {(name, arch) for name in KERNELS for arch in ARCHITECTURES} <= set(usages)
    assert all(0 < use.registers <= 255 for use in usages.values())


@pytest.mark.parametrize("name", TRAINING)
def test_a_training_step_keeps_its_state_in_registers(usages, name):
    memory = {arch: (usages[name, arch].stack, usages[name, arch].local) for arch in ARCHITECTURES}
    in_registers = all(sizes == (0, 0) for sizes in memory.values())
    assert in_registers == (name not in LOCAL_ARRAYS), memory


@pytest.mark.parametrize("name", TRAINING)
def test_a_training_step_fills_half_of_an_rtx_3090(usages, name):
    use = usages[name, 86]
    assert (use.occupancy >= 0.5) == (name not in LOW_OCCUPANCY), use


@pytest.mark.parametrize("name", [*LOCAL_ARRAYS, *LOW_OCCUPANCY])
def test_exceptions_are_explained(name):
    assert f"`{name}`" in DOCS.read_text()


@pytest.mark.parametrize(
    ("architecture", "registers", "shared", "threads", "expected"),
    [  # by hand from the tables: blocks per SM = min over threads, registers, shared memory, block slots
        (86, 32, 0, 256, 6 * 8 / 48),
        (86, 64, 0, 256, 4 * 8 / 48),  # 65536 / (64 * 256) blocks
        (86, 72, 0, 256, 3 * 8 / 48),  # 28 warps of 2304 registers
        (86, 65, 0, 256, 3 * 8 / 48),  # registers come in eights
        (86, 32, 24 * 1024, 256, 4 * 8 / 48),  # 25 KiB with what the system takes, of 100
        (86, 32, 0, 32, 16 / 48),  # 16 blocks
        (86, 32, 0, 33, 32 / 48),  # 16 blocks of two warps
        (75, 32, 16 * 1024, 256, 4 * 8 / 32),  # nothing taken
        (90, 32, 0, 1024, 64 / 64),
        (100, 255, 0, 256, 8 / 64),
    ],
)
def test_occupancy_is_what_the_tables_give(architecture, registers, shared, threads, expected):
    assert occupancy(architecture, registers=registers, shared=shared, threads=threads) == pytest.approx(expected)
