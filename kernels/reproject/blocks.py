"""Compare the colours of reprojected pixels, the GPU's shape: one thread per pixel, float32, sums by blocks of 256.

A pixel reads one value of its own image and four of the other, at a place that its depth decides: there is nothing that
neighbours could share but what the caches hold. What a block shares is the sum: residuals and matches are added up
across it, in a fixed order, and never written one by one.
"""

import warp as wp

from graphgs.kernels.reproject.matching import compare_pixel

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

THREADS = wp.constant(256)  # of a block


@wp.kernel
def compare_reprojected_blocks(
    # Image i
    depth_i: wp.array[float],  # [C Hi Wi]
    alpha_i: wp.array[float],  # [C Hi Wi]
    height_i: int,
    width_i: int,
    # Image j
    depth_j: wp.array[float],  # [C Hj Wj]
    height_j: int,
    width_j: int,
    # Cameras and thresholds
    pixel_map: wp.array[float],  # [C 12]
    unit_depth: int,
    limits: wp.array[float],  # [2] least alpha, depth tolerance
    # Colours
    image_i: wp.array[float],  # [C Hi Wi 3]
    image_j: wp.array[float],  # [C Hj Wj 3]
    # Out
    slopes_image: wp.array[float],  # [C Hi Wi 3] derivative of the residual in the colours of image i
    slopes_depth: wp.array[float],  # [C Hi Wi] and in its depth
    block_sums: wp.array[wp.float64],  # [2 blocks] residuals over all channels by block, then matches by block
):
    block, thread = wp.tid()
    index = block * THREADS + thread
    sums = wp.vec2()
    if index < depth_i.shape[0]:
        residual, match = compare_pixel(
            index,
            depth_i,
            alpha_i,
            height_i,
            width_i,
            depth_j,
            height_j,
            width_j,
            pixel_map,
            unit_depth,
            limits,
            image_i,
            image_j,
            slopes_image,
            slopes_depth,
        )
        sums = wp.vec2(residual, match)
    total = wp.tile_sum(wp.tile(sums, preserve_type=True))[0]  # every thread takes part in the extraction
    if thread == 0:
        block_sums[block] = wp.float64(total[0])
        block_sums[block_sums.shape[0] / 2 + block] = wp.float64(total[1])
