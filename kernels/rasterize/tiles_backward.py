"""Compositing on the CPU, backward: a thread per tile writes a row per intersection, a thread per splat adds them."""

import warp as wp

from graphgs.kernels.cpu_flags import vector_flags
from graphgs.kernels.rasterize.blocks import (
    BACKWARD_SIZE,
    BLOCK,
    LANES,
    REMAINING,
    SUMS,
    V_BLUE,
    V_DEPTH,
    V_GREEN,
    V_LIGHT,
    V_RED,
    V_WEIGHT,
    aligned_start,
    unblend_blocks,
)
from graphgs.kernels.rasterize.constants import TILE_SIZE
from graphgs.kernels.rasterize.tile_lists import RECORD

wp.set_module_options({"enable_backward": False, "max_unroll": 0, "cpu_compiler_flags": vector_flags()})


@wp.kernel
def unblend_tile(
    first: int,
    # Splats
    records: wp.array[float],  # [M * RECORD]
    ranks: wp.array[int],  # [I]
    slots: wp.array[int],  # [I]
    tile_starts: wp.array[int],  # [C * tiles + 1]
    tile_stops: wp.array[int],  # [C * tiles]
    block_masks: wp.array[int],  # [I]
    # Frame
    width: int,
    height: int,
    backgrounds: wp.array[wp.vec3],  # [C]
    # Rendered, and cotangents, [C * H * W]
    render_alphas: wp.array[float],
    sums: wp.array[wp.vec4],
    v_colors: wp.array[wp.vec3],
    v_alphas: wp.array[float],
    v_depths: wp.array[float],
    # Out
    splat_sums: wp.array[float],  # [I * SUMS] by slot, zero before
):
    tile = first + wp.tid()
    columns = (width + TILE_SIZE - 1) // TILE_SIZE
    rows = (height + TILE_SIZE - 1) // TILE_SIZE
    camera = tile // (rows * columns)
    left = (tile % columns) * TILE_SIZE
    top = ((tile // columns) % rows) * TILE_SIZE

    planes = wp.zeros(shape=BACKWARD_SIZE, dtype=float)
    start = aligned_start(planes)
    for k in range(256):
        px = left + BLOCK * ((k // LANES) & 3) + (k & 3)
        py = top + BLOCK * (k // (4 * LANES)) + ((k >> 2) & 3)
        planes[start + V_LIGHT + k] = -1.0
        if px < width and py < height:
            index = (camera * height + py) * width + px
            alpha = render_alphas[index]
            if alpha > 0.0:
                # Cotangents of the plain sums over w: colour, depth, and w itself.
                total = sums[index]
                v_color = v_colors[index]
                v_depth = v_depths[index] / alpha
                v_weight = v_alphas[index] - wp.dot(v_color, backgrounds[camera]) - v_depth * total[3] / alpha
                planes[start + V_RED + k] = v_color[0]
                planes[start + V_GREEN + k] = v_color[1]
                planes[start + V_BLUE + k] = v_color[2]
                planes[start + V_DEPTH + k] = v_depth
                planes[start + V_WEIGHT + k] = v_weight
                planes[start + V_LIGHT + k] = 1.0
                color_part = v_color[0] * total[0] + v_color[1] * total[1] + v_color[2] * total[2]
                planes[start + REMAINING + k] = v_weight * alpha + v_depth * total[3] + color_part

    x = float(left) + 0.5
    y = float(top) + 0.5
    for i in range(tile_starts[tile], tile_stops[tile]):
        if block_masks[i] != 0:
            unblend_blocks(records, ranks[i] * RECORD, x, y, block_masks[i], planes, start, splat_sums, slots[i] * SUMS)


@wp.kernel
def gather_splat(
    first: int,
    splat_ids: wp.array[int],  # [M]
    slot_starts: wp.array[int],  # [M + 1]
    records: wp.array[float],  # [M * RECORD]
    splat_sums: wp.array[float],  # [I * SUMS]
    # Out, [C * N], zero before
    v_means2d: wp.array[wp.vec2],
    v_conics: wp.array[wp.vec3],
    v_depths: wp.array[float],
    v_opacities: wp.array[float],
    v_colors: wp.array[wp.vec3],
):
    rank = first + wp.tid()
    s = splat_ids[rank]
    total = wp.zeros(shape=SUMS, dtype=float)
    for slot in range(slot_starts[rank], slot_starts[rank + 1]):
        for k in range(SUMS):
            total[k] = total[k] + splat_sums[slot * SUMS + k]
    at = rank * RECORD
    a, b, c, opacity = records[at + 2], records[at + 3], records[at + 4], records[at + 5]
    # sigma = (a dx^2 + c dy^2) / 2 + b dx dy, with dx = pixel - mean; alpha = opacity * exp(-sigma)
    v_means2d[s] = -wp.vec2(a * total[1] + b * total[2], b * total[1] + c * total[2])
    v_conics[s] = wp.vec3(0.5 * total[3], total[4], 0.5 * total[5])
    v_opacities[s] = -total[0] / opacity
    v_colors[s] = wp.vec3(total[6], total[7], total[8])
    v_depths[s] = total[9]
