"""Which Gaussians meet which tile, front to back: the plain shape's form (duplicate, sort by tile and depth, find
ranges).

Equal depths keep the order of the Gaussians: the sort is stable.
"""

from dataclasses import dataclass

import warp as wp

from graphgs.kernels.rasterize.constants import TILE_SIZE

wp.set_module_options({"enable_backward": False})


@wp.struct
class Grid:
    columns: int  # tiles per image row
    rows: int
    splats: int  # per camera


@dataclass(frozen=True)
class Intersections:
    splat_ids: wp.array  # [I] int, tile by tile, front to back
    tile_ranges: wp.array  # [C * tiles] vec2i: first, last + 1


@wp.func
def tile_box(mean2d: wp.vec2, radius: wp.vec2i, grid: Grid):
    """First and last + 1 column and row of the tiles under a splat's bounding box."""
    size = float(TILE_SIZE)
    left = wp.clamp(int(wp.floor((mean2d[0] - float(radius[0])) / size)), 0, grid.columns)
    right = wp.clamp(int(wp.ceil((mean2d[0] + float(radius[0])) / size)), 0, grid.columns)
    top = wp.clamp(int(wp.floor((mean2d[1] - float(radius[1])) / size)), 0, grid.rows)
    bottom = wp.clamp(int(wp.ceil((mean2d[1] + float(radius[1])) / size)), 0, grid.rows)
    return left, right, top, bottom


@wp.kernel
def count_tiles(
    # Splats, [C * N]
    means2d: wp.array[wp.vec2],
    radii: wp.array[wp.vec2i],
    grid: Grid,
    # Out
    counts: wp.array[int],  # [C * N]
):
    s = wp.tid()
    count = 0
    if radii[s][0] > 0:
        left, right, top, bottom = tile_box(means2d[s], radii[s], grid)
        count = (right - left) * (bottom - top)
    counts[s] = count


@wp.kernel
def emit_keys(
    # Splats, [C * N]
    means2d: wp.array[wp.vec2],
    radii: wp.array[wp.vec2i],
    depths: wp.array[float],
    ends: wp.array[int],  # inclusive sum of `counts`
    grid: Grid,
    # Out, [2 * I]
    keys: wp.array[wp.int64],  # tile, then depth: a positive float sorts like its bits
    splat_ids: wp.array[int],
):
    s = wp.tid()
    if radii[s][0] > 0:
        left, right, top, bottom = tile_box(means2d[s], radii[s], grid)
        at = ends[s] - (right - left) * (bottom - top)
        depth_bits = wp.int64(wp.cast(depths[s], int))
        first_tile = (s // grid.splats) * grid.rows * grid.columns
        for row in range(top, bottom):
            for column in range(left, right):
                keys[at] = (wp.int64(first_tile + row * grid.columns + column) << wp.int64(32)) | depth_bits
                splat_ids[at] = s
                at += 1


@wp.kernel
def find_ranges(
    keys: wp.array[wp.int64],  # [I] sorted
    count: int,
    # Out
    tile_ranges: wp.array[wp.vec2i],  # [C * tiles], zero before
):
    i = wp.tid()
    tile = int(keys[i] >> wp.int64(32))
    if i == 0 or int(keys[i - 1] >> wp.int64(32)) != tile:
        tile_ranges[tile][0] = i
    if i == count - 1 or int(keys[i + 1] >> wp.int64(32)) != tile:
        tile_ranges[tile][1] = i + 1


def intersect_tiles(
    means2d: wp.array,  # [C * N] vec2, float32
    radii: wp.array,  # [C * N] vec2i
    depths: wp.array,  # [C * N], float32
    *,
    cameras: int,
    width: int,
    height: int,
) -> Intersections:
    """Reads one number back from the device: the count of intersections."""
    device = means2d.device
    size = int(TILE_SIZE)
    grid = Grid()
    grid.columns, grid.rows, grid.splats = -(-width // size), -(-height // size), max(1, means2d.size // cameras)
    tile_ranges = wp.zeros(cameras * grid.rows * grid.columns, dtype=wp.vec2i, device=device)
    if means2d.size == 0:
        return Intersections(wp.empty(0, dtype=int, device=device), tile_ranges)
    ends = wp.empty(means2d.size, dtype=int, device=device)
    wp.launch(count_tiles, dim=means2d.size, inputs=[means2d, radii, grid], outputs=[ends], device=device)
    wp.utils.array_scan(ends, ends, inclusive=True)
    count = int(ends[-1:].numpy()[0])
    keys = wp.empty(2 * count, dtype=wp.int64, device=device)  # the sort wants room for a second copy
    splat_ids = wp.empty(2 * count, dtype=int, device=device)
    if count > 0:
        inputs = [means2d, radii, depths, ends, grid]
        wp.launch(emit_keys, dim=means2d.size, inputs=inputs, outputs=[keys, splat_ids], device=device)
        wp.utils.radix_sort_pairs(keys, splat_ids, count)
        wp.launch(find_ranges, dim=count, inputs=[keys, count], outputs=[tile_ranges], device=device)
    return Intersections(splat_ids, tile_ranges)
