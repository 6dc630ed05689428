"""Compositing on the CPU, forward: one thread per tile, splats outside, blocks of 16 pixels inside."""

import warp as wp

from graphgs.kernels.cpu_flags import vector_flags
from graphgs.kernels.rasterize.blocks import (
    BLOCK,
    BLUE,
    DEPTH,
    FORWARD_SIZE,
    GREEN,
    LANES,
    LIGHT,
    RED,
    aligned_start,
    blend_blocks,
    open_blocks,
)
from graphgs.kernels.rasterize.constants import TILE_SIZE
from graphgs.kernels.rasterize.tile_lists import RECORD

wp.set_module_options({"enable_backward": False, "max_unroll": 0, "cpu_compiler_flags": vector_flags()})

CHECK = wp.constant(15)  # after every 16 splats, blocks whose pixels have all stopped are closed


@wp.kernel
def blend_tile(
    first: int,
    # Splats
    records: wp.array[float],  # [M * RECORD]
    ranks: wp.array[int],  # [I]
    tile_starts: wp.array[int],  # [C * tiles + 1]
    # Frame
    width: int,
    height: int,
    backgrounds: wp.array[wp.vec3],  # [C]
    # Out
    render_colors: wp.array[wp.vec3],  # [C * H * W]
    render_alphas: wp.array[float],
    render_depths: wp.array[float],
    sums: wp.array[wp.vec4],  # [C * H * W] sum of w * (color, depth), without background
    block_masks: wp.array[int],  # [I] a bit for each block in which a pixel took the splat
    tile_stops: wp.array[int],  # [C * tiles] past the last splat that was looked at
):
    tile = first + wp.tid()
    columns = (width + TILE_SIZE - 1) // TILE_SIZE
    rows = (height + TILE_SIZE - 1) // TILE_SIZE
    camera = tile // (rows * columns)
    left = (tile % columns) * TILE_SIZE
    top = ((tile // columns) % rows) * TILE_SIZE

    planes = wp.zeros(shape=FORWARD_SIZE, dtype=float)
    start = aligned_start(planes)
    for k in range(256):
        px = left + BLOCK * ((k // LANES) & 3) + (k & 3)
        py = top + BLOCK * (k // (4 * LANES)) + ((k >> 2) & 3)
        planes[start + LIGHT + k] = wp.where(px < width and py < height, 1.0, -1.0)

    x = float(left) + 0.5
    y = float(top) + 0.5
    open = open_blocks(planes, start + LIGHT)
    i = int(tile_starts[tile])
    end = int(tile_starts[tile + 1])
    while i < end and open != 0:
        block_masks[i] = blend_blocks(records, ranks[i] * RECORD, x, y, open, planes, start)
        i += 1
        if (i & CHECK) == 0:
            open = open_blocks(planes, start + LIGHT)
    tile_stops[tile] = i

    for k in range(256):
        px = left + BLOCK * ((k // LANES) & 3) + (k & 3)
        py = top + BLOCK * (k // (4 * LANES)) + ((k >> 2) & 3)
        if px < width and py < height:
            index = (camera * height + py) * width + px
            light = wp.abs(planes[start + LIGHT + k])
            alpha = 1.0 - light
            color = wp.vec3(planes[start + RED + k], planes[start + GREEN + k], planes[start + BLUE + k])
            depth = planes[start + DEPTH + k]
            render_colors[index] = color + light * backgrounds[camera]
            render_alphas[index] = alpha
            render_depths[index] = wp.where(alpha > 0.0, depth / alpha, 0.0)
            sums[index] = wp.vec4(color[0], color[1], color[2], depth)
