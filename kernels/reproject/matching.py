"""One pixel of camera i: its match in image j, and how the colours of the two compare."""

from typing import Any

import warp as wp

from graphgs.kernels.reproject.geometry import land, lands_inside, seen_depth, seen_value

ROBUST_EPS = wp.constant(1e-3)  # [intensity] below it the robust L1 turns quadratic (Charbonnier)


@wp.func
def match_pixel(
    index: int,  # of the pixel among all pairs
    # Image i
    depth_i: wp.array[Any],
    alpha_i: wp.array[Any],
    height_i: int,
    width_i: int,
    # Image j
    depth_j: wp.array[Any],
    height_j: int,
    width_j: int,
    # Cameras and thresholds
    pixel_map: wp.array[Any],
    unit_depth: int,
    limits: wp.array[Any],  # [2] least alpha, depth tolerance
):
    """Whether the pixel has a match, then what `land` returns, and the pair."""
    row = index / width_i
    pair = row / height_i
    half = limits.dtype(0.5)
    x = limits.dtype(index - row * width_i) + half
    y = limits.dtype(row - pair * height_i) + half
    zero = limits.dtype(0.0)
    depth = limits.dtype(1.0)
    valid = True
    if unit_depth == 0:
        depth = depth_i[index]
        valid = depth > zero and alpha_i[index] >= limits[0]
    qx, qy, z, d_qx, d_qy = land(pixel_map, pair, x, y, depth)
    valid = valid and z > zero and lands_inside(qx, qy, height_j, width_j)
    if valid and unit_depth == 0:
        # Forward-backward check: the point that camera j sees at q lies at depth `seen` on the ray of ours at depth z,
        # so |seen - z| / z is the distance between the two, in units of the distance from the camera: free of scale.
        seen = seen_depth(depth_j, pair, qx, qy, height_j, width_j)
        valid = seen > zero and wp.abs(seen - z) <= limits[1] * z
    return valid, qx, qy, z, d_qx, d_qy, pair


@wp.func
def compare_pixel(
    index: int,
    # Image i
    depth_i: wp.array[Any],
    alpha_i: wp.array[Any],
    height_i: int,
    width_i: int,
    # Image j
    depth_j: wp.array[Any],
    height_j: int,
    width_j: int,
    # Cameras and thresholds
    pixel_map: wp.array[Any],
    unit_depth: int,
    limits: wp.array[Any],
    # Colours
    image_i: wp.array[Any],  # [C Hi Wi 3]
    image_j: wp.array[Any],  # [C Hj Wj 3]
    # Out
    slopes_image: wp.array[Any],  # [C Hi Wi 3] derivative of the residual in the colours of image i
    slopes_depth: wp.array[Any],  # [C Hi Wi] and in its depth
):
    """The residual, summed over the channels, and 1; or 0 and 0 where there is no match."""
    valid, qx, qy, _z, d_qx, d_qy, pair = match_pixel(
        index, depth_i, alpha_i, height_i, width_i, depth_j, height_j, width_j, pixel_map, unit_depth, limits
    )
    zero = image_i.dtype(0.0)
    one = image_i.dtype(1.0)
    eps = image_i.dtype(ROBUST_EPS)
    residual = image_i.dtype(0.0)
    slope_depth = image_i.dtype(0.0)
    matched = image_i.dtype(0.0)
    if valid:
        matched = one
    for channel in range(3):
        slope = zero
        if valid:
            seen, d_x, d_y = seen_value(image_j, pair, qx, qy, channel, height_j, width_j)
            error = image_i[3 * index + channel] - seen
            if unit_depth == 1:  # as printed: plain L1
                residual += wp.abs(error)
                slope = wp.where(error > zero, one, wp.where(error < zero, -one, zero))
            else:
                root = wp.sqrt(error * error + eps * eps)
                residual += error * error / (root + eps)  # = root - eps, without cancellation
                slope = error / root
                slope_depth -= slope * (d_x * d_qx + d_y * d_qy)
        slopes_image[3 * index + channel] = slope
    slopes_depth[index] = slope_depth
    return residual, matched
