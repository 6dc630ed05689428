"""Which splats meet which tile, front to back: the GPU's form (duplicate, sort by tile, find ranges).

Splats are sorted by depth first and emitted in that order, so that a stable sort by tile alone keeps every list front
to back. That sorts 32 bits per splat and, per intersection, only as many as number the tiles, usually 13: with tile and
depth in one 64-bit key the larger of the two sorts would move half as much again, and take three times the passes.
Equal depths keep the order of the splats. A tile is listed only where the ellipse alpha >= ALPHA_MIN meets it.
"""

from dataclasses import dataclass

import warp as wp

from graphgs.kernels.rasterize.buffers import Frame, Splats
from graphgs.kernels.rasterize.constants import ALPHA_MIN, TILE_SIZE
from graphgs.kernels.rasterize.ellipse import Ellipse, alpha_ellipse, band_extent, cells_between
from graphgs.kernels.rasterize.gpu_room import Count, Room

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

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


@wp.kernel
def emit_keys(
    order: wp.array[int],  # [C * N]
    slot_ends: wp.array[int],  # [C * N]
    # Splats, [C * N]
    means2d: wp.array[wp.vec2],
    conics: wp.array[wp.vec3],
    opacities: wp.array[float],
    grid: Grid,
    # Out, [I]
    keys: wp.array[int],  # tile; that behind the last before
    slots: wp.array[int],
    slot_splats: wp.array[int],
):
    rank = wp.tid()
    slot = int(0)
    if rank > 0:
        slot = slot_ends[rank - 1]
    end = wp.min(slot_ends[rank], keys.shape[0])  # there may be less room than intersections
    if slot < end:
        s = order[rank]
        ellipse = alpha_ellipse(conics[s], opacities[s])
        first_tile = (s // grid.splats) * grid.rows * grid.columns
        top, bottom = row_span(means2d[s], ellipse, grid)
        for row in range(top, bottom + 1):
            left, right = column_span(means2d[s], ellipse, row, grid)
            for column in range(left, right + 1):
                if slot < end:
                    keys[slot] = first_tile + row * grid.columns + column
                    slots[slot] = slot
                    slot_splats[slot] = s
                    slot += 1


@wp.kernel
def find_ranges(
    # Sorted, [I]
    keys: wp.array[int],
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
        if i + 1 < keys.shape[0]:
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
    tile_ranges = wp.zeros(tiles, dtype=wp.vec2i, device=device)
    order = wp.empty(2 * size, dtype=int, device=device)  # the sort wants room for a second copy
    slot_ends = wp.empty(size, dtype=int, device=device)
    if size == 0:
        return GpuLists(order, order, tile_ranges, order, slot_ends, None)

    depth_keys = room.scratch("depth_keys", 2 * size)
    inputs = [splats.depths, radii, splats.opacities]
    wp.launch(write_depth_keys, dim=size, inputs=inputs, outputs=[depth_keys, order], device=device)
    wp.utils.radix_sort_pairs(depth_keys, order, size, end_bit=DEPTH_BITS)
    shapes = [splats.means2d, splats.conics, splats.opacities, grid]
    wp.launch(count_tiles, dim=size, inputs=[depth_keys, order, *shapes], outputs=[slot_ends], device=device)
    wp.utils.array_scan(slot_ends, slot_ends, inclusive=True)

    familiar = room.is_familiar(size, frame.cameras, frame.width, frame.height)
    count = room.send(slot_ends[-1:])
    if exact or not familiar or not room.deferred:
        room.fit(count.read())
        count = None

    capacity = room.capacity
    keys, sorted_slots = room.scratch("keys", 2 * capacity), room.scratch("slots", 2 * capacity)
    slot_splats = room.scratch("slot_splats", capacity)
    splat_ids, slots = (wp.empty(capacity, dtype=int, device=device) for _ in range(2))
    keys[:capacity].fill_(tiles)
    wp.launch(
        emit_keys,
        dim=size,
        inputs=[order, slot_ends, *shapes],
        outputs=[keys[:capacity], sorted_slots, slot_splats],
        device=device,
    )
    wp.utils.radix_sort_pairs(keys, sorted_slots, capacity, end_bit=tiles.bit_length())
    wp.launch(
        find_ranges,
        dim=capacity,
        inputs=[keys[:capacity], sorted_slots, slot_splats],
        outputs=[splat_ids, slots, tile_ranges],
        device=device,
    )
    return GpuLists(splat_ids, slots, tile_ranges, order, slot_ends, count)
