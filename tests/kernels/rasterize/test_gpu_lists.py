"""The GPU's tile lists hold every splat that a tile needs, front to back, in two numberings that agree."""

import numpy as np
import pytest
import warp as wp

from graphgs.kernels.rasterize.buffers import Frame, Splats
from graphgs.kernels.rasterize.gpu_lists import GpuLists, list_tiles
from graphgs.kernels.rasterize.gpu_room import Room
from tests.support.splats import SplatScene, make_splats

WIDTH, HEIGHT, CAMERAS, N = 75, 50, 2, 60
COLUMNS, ROWS = 5, 4


@pytest.fixture(scope="module")
def scene() -> SplatScene:
    scene = make_splats(N, WIDTH, HEIGHT, cameras=CAMERAS, sigma=(0.5, 25.0), opacity=(0.002, 1.0), seed=1)
    scene.splats["depths"][:, 10:20] = 4.0
    return scene


def run(scene: SplatScene, device: str) -> GpuLists:
    types = {"means2d": wp.vec2, "conics": wp.vec3, "colors": wp.vec3}
    arrays = {
        name: wp.array(array.reshape(-1, *array.shape[2:]), dtype=types.get(name, float), device=device)
        for name, array in scene.splats.items()
    }
    radii = wp.array(scene.radii.reshape(-1, 2), dtype=wp.vec2i, device=device)
    frame = Frame(CAMERAS, WIDTH, HEIGHT, wp.zeros(CAMERAS, dtype=wp.vec3, device=device))
    return list_tiles(Splats(**arrays), radii, frame, Room(device, deferred=False), exact=True)


def listed(lists: GpuLists) -> list[np.ndarray]:
    """Per tile, positions in the list."""
    return [np.arange(first, last) for first, last in lists.tile_ranges.numpy()]


def alpha_over_pixels(scene: SplatScene, s: int) -> np.ndarray:
    """[H, W]"""
    mean, conic, opacity = (
        scene.splats[name].reshape(CAMERAS * N, -1)[s] for name in ("means2d", "conics", "opacities")
    )
    dx = np.arange(WIDTH)[None] + 0.5 - mean[0]
    dy = np.arange(HEIGHT)[:, None] + 0.5 - mean[1]
    return opacity * np.exp(-0.5 * (conic[0] * dx**2 + conic[2] * dy**2) - conic[1] * dx * dy)


def test_every_needed_tile_is_listed_and_few_others(scene, device):
    lists = run(scene, device)
    ids = lists.splat_ids.numpy()
    found = {(tile, s) for tile, at in enumerate(listed(lists)) for s in ids[at]}
    needed = set()
    for s in np.flatnonzero(scene.radii[..., 0].ravel() > 0):
        py, px = np.nonzero(alpha_over_pixels(scene, s) >= 1 / 255)
        base = (s // N) * ROWS * COLUMNS
        needed |= {(base + y // 16 * COLUMNS + x // 16, s) for y, x in zip(py, px, strict=True)}
    assert needed <= found
    # A tile whose pixel centres all lie just outside a passing ellipse is listed too.
    assert len(found) <= 1.1 * len(needed)


def test_tiles_are_front_to_back_and_equal_depths_in_order(scene, device):
    lists = run(scene, device)
    ids, depths = lists.splat_ids.numpy(), scene.splats["depths"].astype(np.float32).ravel()
    for at in listed(lists):
        keys = list(zip(depths[ids[at]], ids[at], strict=True))
        assert keys == sorted(keys)


def test_slots_number_the_intersections_splat_by_splat(scene, device):
    lists = run(scene, device)
    at = np.concatenate(listed(lists))
    ids, slots = lists.splat_ids.numpy()[at], lists.slots.numpy()[at]
    order, ends = lists.order.numpy()[: CAMERAS * N], lists.slot_ends.numpy()
    assert sorted(slots) == list(range(ends[-1]))
    owners = order[np.searchsorted(ends, slots, side="right")]
    assert np.array_equal(owners, ids)
