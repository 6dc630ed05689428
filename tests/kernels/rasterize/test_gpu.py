"""The GPU's shape, run on the CPU with every thread of a block, against the plain shape in float64."""

import numpy as np
import pytest
import warp as wp

from graphgs.kernels.rasterize.gpu import IntersectionOverflow, composite_gpu, composite_gpu_backward
from graphgs.kernels.rasterize.gpu_room import Room
from graphgs.kernels.rasterize.pixels import composite_pixels, composite_pixels_backward
from tests.support.splats import SplatScene, composite_by_kernels, make_splats

SCENES = {
    "several tiles": make_splats(60),
    "more in a tile than a batch": make_splats(600, sigma=(2.0, 12.0), opacity=(0.005, 0.05), seed=1),
    "saturated": make_splats(200, sigma=(3.0, 12.0), opacity=(0.8, 1.0), seed=2),
    "one channel, masked": make_splats(60, channels=1, masked=True, seed=3),
    "five channels, two cameras, masked": make_splats(50, channels=5, cameras=2, masked=True, seed=4),
    "32 channels, two cameras": make_splats(40, 20, 9, channels=32, cameras=2, seed=5),
    "equal depths": make_splats(80, equal_depths=True, seed=6),
    "needles": make_splats(60, sigma=(0.3, 40.0), seed=7),
    "empty": make_splats(0),
    "nothing visible": make_splats(30, opacity=(0.0, 0.003)),
    "one pixel": make_splats(40, 1, 1, seed=8),
}

pytestmark = pytest.mark.usefixtures("cpu_blocks")


def render(scene: SplatScene, device: str, **options):
    return composite_by_kernels(scene, composite_gpu, composite_gpu_backward, device=device, **options)


def assert_close(got: tuple[dict, dict], expected: tuple[dict, dict]) -> None:
    # float32 rounds at 6e-8; light taken away splat by splat and the sums over pixels amplify that about 100 times.
    for got_part, expected_part in zip(got, expected, strict=True):
        for key, want in expected_part.items():
            assert np.linalg.norm(got_part[key] - want) <= 2e-5 * max(np.linalg.norm(want), 1e-6), key


@pytest.mark.parametrize("name", SCENES)
def test_values_and_gradients_equal_the_plain_shape(name, device):
    scene = SCENES[name]
    expected = composite_by_kernels(scene, composite_pixels, composite_pixels_backward, real=wp.float64)
    fresh = Room(device, deferred=True)
    assert_close(render(scene, device, room=fresh), expected)


def test_what_is_not_wanted_changes_nothing(device):
    scene = make_splats(60)
    scene.cotangents["median_depths"][:] = 0
    full, lean = render(scene, device), render(scene, device, features=False)
    for full_part, lean_part in zip(full, lean, strict=True):
        assert all(np.array_equal(value, full_part[key]) for key, value in lean_part.items())


def test_the_same_bits_every_time(device):
    first, second = (render(SCENES["saturated"], device) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        assert all(np.array_equal(value, other[key]) for key, value in one.items())


def test_a_block_of_one_thread_is_refused(monkeypatch):
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", False)
    with pytest.raises(RuntimeError, match="enable_cpu_blocks"):
        render(SCENES["several tiles"], "cpu")


def pair() -> tuple[SplatScene, SplatScene]:
    """Scenes of equal size; the second has many times the intersections of the first."""
    return make_splats(600, 65, 49, sigma=(0.3, 0.5), seed=9), make_splats(600, 65, 49, sigma=(20.0, 30.0), seed=9)


def test_too_little_room_raises_and_the_repeated_step_succeeds(device):
    small, large = pair()
    room = Room(device, deferred=True)
    render(small, device, room=room)  # the first view of a size is counted before it is composited
    before = room.capacity
    with pytest.raises(IntersectionOverflow) as caught:
        render(large, device, room=room)
    assert caught.value.capacity == before < caught.value.count <= room.capacity
    assert_close(render(large, device, room=room), render(large, device))


def test_exact_lists_are_whole_in_any_room(device):
    small, large = pair()
    room = Room(device, deferred=True)
    render(small, device, room=room)
    assert_close(render(large, device, room=room, exact=True), render(large, device))


def test_a_view_keeps_its_lists_while_others_are_composited(device):
    """Scratch memory is shared between views; what the backward pass reads is not."""
    small, large = pair()
    room = Room(device, deferred=True)

    def forward(*operands, **options):
        state = composite_gpu(*operands, **options)
        render(small, device, room=room)
        return state

    got = composite_by_kernels(large, forward, composite_gpu_backward, device=device, room=room)
    assert_close(got, render(large, device))


def test_steps_reuse_their_memory(device):
    scene = SCENES["several tiles"]
    room = Room(device, deferred=True)
    pointers = []
    for _ in range(4):
        render(scene, device, room=room)
        pointers.append([room.scratch(name, 1).ptr for name in ("depth_keys", "keys", "slots", "slot_splats")])
    assert pointers[1:] == pointers[:-1]
    assert len(room._mailboxes) == 1
