"""Which splats meet which tile, front to back: the GPU's form (duplicate, sort by tile, find ranges).

Splats are sorted by depth first and emitted in that order, so that a stable sort by tile alone keeps every list front
to back. That sorts 32 bits per splat and, per intersection, only as many as number the tiles, usually 13: with tile and
depth in one 64-bit key the larger of the two sorts would move half as much again, and take three times the passes.
Equal depths keep the order of the splats. A tile is listed only where the ellipse alpha >= ALPHA_MIN meets it.
"""

from dataclasses import dataclass

import warp as wp

from graphgs.kernels.launch import launch
from graphgs.kernels.rasterize.buffers import Frame, Splats, or_empty
from graphgs.kernels.rasterize.constants import ALPHA_MIN, TILE_SIZE
from graphgs.kernels.rasterize.ellipse import Ellipse, alpha_ellipse, band_extent, cells_between
from graphgs.kernels.rasterize.gpu_room import Count, Room

# Two kernels walk a splat's tiles, one to count and one to list them: unfused, they round alike, and agree on each.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fuse_fp": False})

HIDDEN = wp.constant(0x7FFFFFFF)  # sorts behind every depth
DEPTH_BITS = 31  # a positive float sorts like its bits


@dataclass(frozen=True)
class GpuLists:
    """I is the room for intersections; entries past the count are never reached from `tile_ranges`."""

    splat_ids: wp.array  # [I] int, tile by tile, front to back
    slots: wp.array  # [I] int: the same intersections counted splat by splat, where a gradient is written
    tile_ranges: wp.array  # [C * tiles] vec2i: first, last + 1
    order: wp.array  # [C * N] int: splats by depth, all cameras together, those not visible at the end
    slot_ends: wp.array  # [C * N] int, in that order: last + 1 of a splat's slots
    count: Count | None  # None: exact


@wp.struct
class Grid:
    columns: int  # tiles per image row
    rows: int
    splats: int  # per camera


@wp.kernel
def write_depth_keys(
    # Splats, [C * N]
    depths: wp.array[float],
    radii: wp.array[wp.vec2i],
    opacities: wp.array[float],
    # Out
    keys: wp.array[int],
    order: wp.array[int],
):
    s = wp.tid()
    visible = radii[s][0] > 0 and opacities[s] >= ALPHA_MIN
    keys[s] = wp.where(visible, wp.cast(depths[s], int), HIDDEN)
    order[s] = s


@wp.func
def row_span(mean2d: wp.vec2, ellipse: Ellipse, grid: Grid):
    """First and last row of tiles that the ellipse meets; first > last where it meets none."""
    return cells_between(mean2d[1] - ellipse.height, mean2d[1] + ellipse.height, float(TILE_SIZE), grid.rows)


@wp.func
def column_span(mean2d: wp.vec2, ellipse: Ellipse, row: int, grid: Grid):
    """First and last tile of that row."""
    top = float(row * TILE_SIZE) + 0.5 - mean2d[1]
    left, right = band_extent(ellipse, top, top + float(TILE_SIZE - 1))
    return cells_between(mean2d[0] + left, mean2d[0] + right, float(TILE_SIZE), grid.columns)


@wp.kernel
def count_tiles(
    keys: wp.array[int],  # [C * N] sorted
    order: wp.array[int],  # [C * N]
    # Splats, [C * N]
    means2d: wp.array[wp.vec2],
    conics: wp.array[wp.vec3],
    opacities: wp.array[float],
    grid: Grid,
    # Out
    counts: wp.array[int],  # [C * N] by rank
):
    rank = wp.tid()
    count = int(0)
    if keys[rank] != HIDDEN:
        s = order[rank]
        ellipse = alpha_ellipse(conics[s], opacities[s])
        top, bottom = row_span(means2d[s], ellipse, grid)
        for row in range(top, bottom + 1):
            left, right = column_span(means2d[s], ellipse, row, grid)
            count += right - left + 1
    counts[rank] = count


@wp.func
def rank_of_slot(slot_ends: wp.array[int], slot: int):
    """The first rank whose slots end behind this one."""
    low = int(0)
    high = slot_ends.shape[0] - 1
    while low < high:
        middle = (low + high) // 2
        if slot_ends[middle] > slot:
            high = middle
        else:
            low = middle + 1
    return low


@wp.kernel
def emit_keys(
    order: wp.array[int],  # [C * N]
    slot_ends: wp.array[int],  # [C * N]
    # Splats, [C * N]
    means2d: wp.array[wp.vec2],
    conics: wp.array[wp.vec3],
    opacities: wp.array[float],
    grid: Grid,
    tiles: int,  # C * tiles of an image
    capacity: int,  # I
    # Out, [I]
    keys: wp.array[int],  # tile, or `tiles` where there are fewer intersections than room
    slots: wp.array[int],
    slot_splats: wp.array[int],
    # Out
    tile_ranges: wp.array[wp.vec2i],  # [C * tiles] zero, for `find_ranges`
    count: wp.array[int],  # [1] intersections, or empty
):
    """A thread per slot, which looks for its splat and tile: a large splat keeps no thread longer than a small one."""
    slot = wp.tid()
    total = slot_ends[slot_ends.shape[0] - 1]
    if slot == 0 and count.shape[0] > 0:
        count[0] = total
    key = tiles
    if slot < total:
        rank = rank_of_slot(slot_ends, slot)
        s = order[rank]
        place = slot
        if rank > 0:
            place -= slot_ends[rank - 1]
        ellipse = alpha_ellipse(conics[s], opacities[s])
        row, bottom = row_span(means2d[s], ellipse, grid)
        left, right = column_span(means2d[s], ellipse, row, grid)
        while place > right - left and row < bottom:
            place -= right - left + 1
            row += 1
            left, right = column_span(means2d[s], ellipse, row, grid)
        key = ((s // grid.splats) * grid.rows + row) * grid.columns + left + place
        slot_splats[slot] = s
    keys[slot] = key
    slots[slot] = slot
    for tile in range(slot, tiles, capacity):
        tile_ranges[tile] = wp.vec2i(0, 0)


@wp.kernel
def find_ranges(
    # Sorted, [I]
    keys: wp.array[int],
    capacity: int,
    sorted_slots: wp.array[int],
    slot_splats: wp.array[int],
    # Out
    splat_ids: wp.array[int],  # [I]
    slots: wp.array[int],  # [I]
    tile_ranges: wp.array[wp.vec2i],  # [C * tiles], zero before
):
    i = wp.tid()
    tile = keys[i]
    if tile < tile_ranges.shape[0]:
        slots[i] = sorted_slots[i]
        splat_ids[i] = slot_splats[sorted_slots[i]]
        before = int(-1)
        if i > 0:
            before = keys[i - 1]
        behind = int(-1)
        if i + 1 < capacity:
            behind = keys[i + 1]
        if before != tile:
            tile_ranges[tile][0] = i
        if behind != tile:
            tile_ranges[tile][1] = i + 1


def list_tiles(
    splats: Splats,
    radii: wp.array,  # [C * N] vec2i, 0 = not visible
    frame: Frame,
    room: Room,
    *,
    exact: bool,  # read the count, so that the lists are whole
) -> GpuLists:
    """Reads nothing back from the device, unless `exact`, or the sizes are not those of the view before."""
    device, size = splats.depths.device, splats.depths.size
    grid = Grid()
    grid.columns, grid.rows = -(-frame.width // int(TILE_SIZE)), -(-frame.height // int(TILE_SIZE))
    grid.splats = max(1, size // frame.cameras)
    tiles = frame.cameras * grid.rows * grid.columns
    if size == 0:
        none = or_empty(None, int, device)
        return GpuLists(none, none, wp.zeros(tiles, dtype=wp.vec2i, device=device), none, none, None)

    depth_keys = room.scratch("depth_keys", 2 * size)
    # The sort wants room for a second copy.
    order, slot_ends, tile_ranges = room.lend("splats", (int, 2 * size), (int, size), (wp.vec2i, tiles))
    inputs = [splats.depths, radii, splats.opacities]
    launch(write_depth_keys, size, inputs=inputs, outputs=[depth_keys, order], device=device)
    wp.utils.radix_sort_pairs(depth_keys, order, size, end_bit=DEPTH_BITS)
    shapes = [splats.means2d, splats.conics, splats.opacities, grid]
    launch(count_tiles, size, inputs=[depth_keys, order, *shapes], outputs=[slot_ends], device=device)
    wp.utils.array_scan(slot_ends, slot_ends, inclusive=True)

    familiar = room.is_familiar(size, frame.cameras, frame.width, frame.height)
    count = room.count() if familiar and room.deferred and not exact else None
    if count is None:
        room.fit(int(slot_ends[-1:].numpy()[0]))
    capacity = room.capacity
    keys, sorted_slots = room.scratch("keys", 2 * capacity), room.scratch("slots", 2 * capacity)
    slot_splats = room.scratch("slot_splats", capacity)
    splat_ids, slots = room.lend("lists", (int, capacity), (int, capacity))
    launch(
        emit_keys,
        capacity,
        inputs=[order, slot_ends, *shapes, tiles, capacity],
        outputs=[keys, sorted_slots, slot_splats, tile_ranges, or_empty(count and count.value, int, device)],
        device=device,
    )
    if count is not None:
        count.send()
    wp.utils.radix_sort_pairs(keys, sorted_slots, capacity, end_bit=tiles.bit_length())
    launch(
        find_ranges,
        capacity,
        inputs=[keys, capacity, sorted_slots, slot_splats],
        outputs=[splat_ids, slots, tile_ranges],
        device=device,
    )
    return GpuLists(splat_ids, slots, tile_ranges, order, slot_ends, count)
