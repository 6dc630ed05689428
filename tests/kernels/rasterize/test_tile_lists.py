"""The CPU's tile lists hold every splat that a tile needs, front to back, in two numberings that agree."""

import numpy as np
import pytest
import warp as wp

from graphgs.kernels.rasterize.buffers import Frame, Splats
from graphgs.kernels.rasterize.tile_lists import list_tiles

WIDTH, HEIGHT, CAMERAS, N = 75, 50, 2, 60
COLUMNS, ROWS = 5, 4


@pytest.fixture(scope="module")
def splats() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    m = CAMERAS * N
    axes = np.exp(rng.uniform(np.log(0.5), np.log(25), (m, 2)))
    angle = rng.uniform(0, np.pi, m)
    cos, sin = np.cos(angle), np.sin(angle)
    a = cos**2 / axes[:, 0] ** 2 + sin**2 / axes[:, 1] ** 2
    b = cos * sin * (1 / axes[:, 0] ** 2 - 1 / axes[:, 1] ** 2)
    c = sin**2 / axes[:, 0] ** 2 + cos**2 / axes[:, 1] ** 2
    depths = rng.uniform(1, 9, m)
    depths[10:20] = 4.0
    radii = np.full((m, 2), 99, np.int32)
    radii[5::7] = 0
    return {
        "means2d": rng.uniform((-20, -20), (WIDTH + 20, HEIGHT + 20), (m, 2)).astype(np.float32),
        "conics": np.stack([a, b, c], -1).astype(np.float32),
        "depths": depths.astype(np.float32),
        "opacities": rng.uniform(0.01, 1, m).astype(np.float32),
        "colors": rng.uniform(0, 1, (m, 3)).astype(np.float32),
        "radii": radii,
    }


def run(splats: dict[str, np.ndarray], threads: int):
    types = {"means2d": wp.vec2, "conics": wp.vec3, "colors": wp.vec3, "radii": wp.vec2i}
    arrays = {k: wp.from_numpy(v, dtype=types.get(k, wp.float32), device="cpu") for k, v in splats.items()}
    backgrounds = wp.zeros(CAMERAS, dtype=wp.vec3, device="cpu")
    radii = arrays.pop("radii")
    return list_tiles(Splats(**arrays), radii, Frame(CAMERAS, WIDTH, HEIGHT, backgrounds), threads=threads)


def alpha_over_pixels(splats: dict[str, np.ndarray], s: int) -> np.ndarray:
    """[H, W]"""
    dx = np.arange(WIDTH)[None] + 0.5 - float(splats["means2d"][s, 0])
    dy = np.arange(HEIGHT)[:, None] + 0.5 - float(splats["means2d"][s, 1])
    a, b, c = splats["conics"][s].astype(float)
    return splats["opacities"][s] * np.exp(-0.5 * (a * dx**2 + c * dy**2) - b * dx * dy)


def test_every_needed_tile_is_listed_and_few_others(splats):
    lists = run(splats, threads=1)
    ids, starts, ranks = lists.splat_ids.numpy(), lists.tile_starts.numpy(), lists.ranks.numpy()
    listed = {(t, ids[r]) for t in range(len(starts) - 1) for r in ranks[starts[t] : starts[t + 1]]}
    needed = set()
    for s in np.flatnonzero(splats["radii"][:, 0] > 0):
        py, px = np.nonzero(alpha_over_pixels(splats, s) >= 1 / 255)
        base = (s // N) * ROWS * COLUMNS
        needed |= {(base + y // 16 * COLUMNS + x // 16, s) for y, x in zip(py, px, strict=True)}
    assert needed <= listed
    # A tile whose pixel centres all lie just outside a passing ellipse is listed too.
    assert len(listed) <= 1.1 * len(needed)


def test_tiles_are_front_to_back_and_equal_depths_in_order(splats):
    lists = run(splats, threads=1)
    ids, starts, ranks = lists.splat_ids.numpy(), lists.tile_starts.numpy(), lists.ranks.numpy()
    for t in range(len(starts) - 1):
        tile_ids = ids[ranks[starts[t] : starts[t + 1]]]
        keys = list(zip(splats["depths"][tile_ids], tile_ids, strict=True))
        assert keys == sorted(keys)


def test_slots_number_the_intersections_splat_by_splat(splats):
    lists = run(splats, threads=1)
    ranks, slots, slot_starts = lists.ranks.numpy(), lists.slots.numpy(), lists.slot_starts.numpy()
    assert sorted(slots) == list(range(len(ranks)))
    assert (slot_starts[ranks] <= slots).all()
    assert (slots < slot_starts[ranks + 1]).all()


def test_lists_do_not_depend_on_the_number_of_threads(splats):
    one, three = run(splats, threads=1), run(splats, threads=3)
    for name in ("splat_ids", "ranks", "slots", "tile_starts", "slot_starts"):
        assert np.array_equal(getattr(one, name).numpy(), getattr(three, name).numpy()), name
