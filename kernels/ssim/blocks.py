"""SSIM and L1, the GPU's shape: one block of threads per tile of 16 x 16 pixels, float32, separable.

Channel by channel, the block reads the tile and its halo of 5 px into shared memory once, smooths along the rows into a
second shared tile, then every thread smooths along its own column: 29 reads of shared memory per value, where the plain
shape has 121 of global memory. The sums of a tile are added up across the block, in a fixed order.

A halo is neither aligned nor inside the image, and the flat images are interleaved, so `wp.tile_load` would need a copy
of them with a margin. `wp.tile_scatter_masked` writes what each thread has fetched, at an index of the thread's choice,
and `wp.tile_extract` reads a shared tile at a dynamic index; the former waits for the whole block.
"""

import warp as wp

from graphgs.kernels.ssim.window import RADIUS, TAPS, l1_slope, ssim_terms

wp.set_module_options({"enable_backward": False, "max_unroll": 0, "default_grid_stride": False})

TILE = wp.constant(16)  # [px]
THREADS = wp.constant(TILE * TILE)  # of a block: one per pixel of the tile
REACH = wp.constant(RADIUS)
SPAN = wp.constant(TILE + 2 * RADIUS)  # the tile and its halo along one axis
SPAN_PIXELS = wp.constant(SPAN * SPAN)
STRIP_PIXELS = wp.constant(SPAN * TILE)  # smoothed along the rows, still to be smoothed along the columns


@wp.struct
class TilePlace:
    """Where a tile lies."""

    top: int  # [px] in its image
    left: int
    first_row: int  # of its image, in all images stacked


@wp.func
def tile_place(block: int, height: int, columns: int):
    """Tiles are numbered image by image, row by row."""
    rows = (height + TILE - 1) / TILE
    place = TilePlace()
    place.top = (block / columns) % rows * TILE
    place.left = block % columns * TILE
    place.first_row = block / (columns * rows) * height
    return place


@wp.func
def halo_value(place: TilePlace, p: int, channel: int, height: int, width: int):
    """Index of the value of the p-th pixel of tile and halo; -1 beyond the image's rim."""
    y = place.top + p / SPAN - REACH
    x = place.left + p % SPAN - REACH
    if p < SPAN_PIXELS and y >= 0 and y < height and x >= 0 and x < width:
        return ((place.first_row + y) * width + x) * 3 + channel
    return -1


@wp.kernel
def compare_blocks(
    # Images, [C H W 3] flat
    a: wp.array[float],
    b: wp.array[float],
    kept: wp.array[float],  # 1 or 0
    height: int,
    width: int,
    columns: int,  # tiles in a row
    # Out
    slopes: wp.array[float],  # [3 C H W 3] derivatives of kept SSIM in the windowed means of a, a^2 + b^2, a b
    tile_sums: wp.array[wp.float64],  # [2 tiles] kept |a - b| by tile, then kept SSIM by tile
):
    block, thread = wp.tid()
    place = tile_place(block, height, columns)
    x = place.left + thread % TILE
    y = place.top + thread / TILE
    inside = x < width and y < height
    here = ((place.first_row + y) * width + x) * 3
    count = a.shape[0]
    sums = wp.vec2()

    pixels = wp.tile_empty(shape=SPAN_PIXELS, dtype=wp.vec2, storage="shared")  # a, b
    strips = wp.tile_empty(shape=STRIP_PIXELS, dtype=wp.vec4, storage="shared")  # means of a, b, a^2 + b^2, a b
    for channel in range(3):
        for turn in range((SPAN_PIXELS + THREADS - 1) // THREADS):
            p = turn * THREADS + thread
            at = halo_value(place, p, channel, height, width)
            pair = wp.vec2()  # zero padding, as 3DGS trains
            if at >= 0:
                pair = wp.vec2(a[at], b[at])
            wp.tile_scatter_masked(pixels, p, pair, p < SPAN_PIXELS)
        for turn in range((STRIP_PIXELS + THREADS - 1) // THREADS):
            p = turn * THREADS + thread
            means = wp.vec4()
            if p < STRIP_PIXELS:
                first = p / TILE * SPAN + p % TILE
                for tap in range(2 * REACH + 1):
                    pair = wp.tile_extract(pixels, first + tap)
                    energy = pair[0] * pair[0] + pair[1] * pair[1]
                    means += float(TAPS[tap]) * wp.vec4(pair[0], pair[1], energy, pair[0] * pair[1])
            wp.tile_scatter_masked(strips, p, means, p < STRIP_PIXELS)
        means = wp.vec4()
        for tap in range(2 * REACH + 1):
            means += float(TAPS[tap]) * wp.tile_extract(strips, thread + tap * TILE)
        if inside:
            value, d_mean, d_squares, d_products = ssim_terms(means[0], means[1], means[2], means[3])
            at = here + channel
            keep = kept[at]
            slopes[at] = keep * d_mean
            slopes[count + at] = keep * d_squares
            slopes[2 * count + at] = keep * d_products
            sums += keep * wp.vec2(wp.abs(a[at] - b[at]), value)

    block_sums = wp.tile_sum(wp.tile(sums, preserve_type=True))[0]  # every thread takes part in the extraction
    if thread == 0:
        tile_sums[block] = wp.float64(block_sums[0])
        tile_sums[tile_sums.shape[0] / 2 + block] = wp.float64(block_sums[1])


@wp.kernel
def compare_blocks_gradient(
    # Images, [C H W 3] flat; the gradient is that of `a`
    a: wp.array[float],
    b: wp.array[float],
    kept: wp.array[float],  # 1 or 0
    height: int,
    width: int,
    columns: int,  # tiles in a row
    slopes: wp.array[float],  # [3 C H W 3] from `compare_blocks`
    v_sums: wp.array[float],  # [2] gradient of the sum of errors, of the sum of similarities
    # Out
    v_a: wp.array[float],  # [C H W 3]
):
    block, thread = wp.tid()
    place = tile_place(block, height, columns)
    x = place.left + thread % TILE
    y = place.top + thread / TILE
    inside = x < width and y < height
    here = ((place.first_row + y) * width + x) * 3
    count = a.shape[0]

    # The window is symmetric, so its adjoint is the same blur, applied to the slopes
    pixels = wp.tile_empty(shape=SPAN_PIXELS, dtype=wp.vec3, storage="shared")
    strips = wp.tile_empty(shape=STRIP_PIXELS, dtype=wp.vec3, storage="shared")
    for channel in range(3):
        for turn in range((SPAN_PIXELS + THREADS - 1) // THREADS):
            p = turn * THREADS + thread
            at = halo_value(place, p, channel, height, width)
            three = wp.vec3()
            if at >= 0:
                three = wp.vec3(slopes[at], slopes[count + at], slopes[2 * count + at])
            wp.tile_scatter_masked(pixels, p, three, p < SPAN_PIXELS)
        for turn in range((STRIP_PIXELS + THREADS - 1) // THREADS):
            p = turn * THREADS + thread
            along_row = wp.vec3()
            if p < STRIP_PIXELS:
                first = p / TILE * SPAN + p % TILE
                for tap in range(2 * REACH + 1):
                    along_row += float(TAPS[tap]) * wp.tile_extract(pixels, first + tap)
            wp.tile_scatter_masked(strips, p, along_row, p < STRIP_PIXELS)
        blurred = wp.vec3()
        for tap in range(2 * REACH + 1):
            blurred += float(TAPS[tap]) * wp.tile_extract(strips, thread + tap * TILE)
        if inside:
            at = here + channel
            v_similarity = blurred[0] + 2.0 * a[at] * blurred[1] + b[at] * blurred[2]
            v_a[at] = kept[at] * (v_sums[0] * l1_slope(a[at], b[at]) + v_sums[1] * v_similarity)
