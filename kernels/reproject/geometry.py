"""Where a pixel of camera i lands in camera j's image, and what is seen there.

Pixel centres lie at +0.5. A `pixel_map` is 12 numbers per camera pair: M = K_j R K_i^-1 row by row, then K_j T, with
(R, T) = cam_j_from_cam_i; a pixel p at depth d lands at the homogeneous point d M p + K_j T, whose third entry is the
depth in camera j.
"""

from typing import Any

import warp as wp


@wp.func
def land(
    pixel_map: wp.array[Any],  # [C 12]
    pair: int,
    x: Any,  # [px] in image i
    y: Any,
    depth: Any,  # in camera i
):
    """(x, y) in image j [px], depth in camera j, and the derivatives of x and y in `depth`."""
    at = 12 * pair
    ray_x = pixel_map[at] * x + pixel_map[at + 1] * y + pixel_map[at + 2]
    ray_y = pixel_map[at + 3] * x + pixel_map[at + 4] * y + pixel_map[at + 5]
    ray_z = pixel_map[at + 6] * x + pixel_map[at + 7] * y + pixel_map[at + 8]
    z = depth * ray_z + pixel_map[at + 11]
    inverse = type(x)(1.0) / z
    qx = (depth * ray_x + pixel_map[at + 9]) * inverse
    qy = (depth * ray_y + pixel_map[at + 10]) * inverse
    return qx, qy, z, (ray_x - qx * ray_z) * inverse, (ray_y - qy * ray_z) * inverse


@wp.func
def lands_inside(qx: Any, qy: Any, height: int, width: int):
    """Between the centres of the image's outermost pixels, where bilinear sampling needs no extrapolation."""
    half = type(qx)(0.5)
    return qx >= half and qy >= half and qx <= type(qx)(width) - half and qy <= type(qx)(height) - half


@wp.func
def bilinear_cell(
    q: Any,  # [px] along one axis, inside
    size: int,  # [px]
):
    """The pixel before `q`, the one after, and how far `q` has come from the first to the second."""
    along = q - type(q)(0.5)
    before = wp.clamp(int(along), 0, wp.max(size - 2, 0))
    return before, wp.min(before + 1, size - 1), along - type(q)(before)


@wp.func
def seen_depth(
    depth_j: wp.array[Any],  # [C Hj Wj]
    pair: int,
    qx: Any,
    qy: Any,
    height: int,
    width: int,
):
    """Bilinear depth of image j, or 0 where one of the four pixels has none."""
    x0, x1, fx = bilinear_cell(qx, width)
    y0, y1, fy = bilinear_cell(qy, height)
    upper = (pair * height + y0) * width
    lower = (pair * height + y1) * width
    d00 = depth_j[upper + x0]
    d01 = depth_j[upper + x1]
    d10 = depth_j[lower + x0]
    d11 = depth_j[lower + x1]
    zero = type(qx)(0.0)
    if d00 > zero and d01 > zero and d10 > zero and d11 > zero:
        return wp.lerp(wp.lerp(d00, d01, fx), wp.lerp(d10, d11, fx), fy)
    return zero


@wp.func
def seen_value(
    image_j: wp.array[Any],  # [C Hj Wj 3]
    pair: int,
    qx: Any,
    qy: Any,
    channel: int,
    height: int,
    width: int,
):
    """Bilinear value of one channel of image j, and its derivatives in `qx` and `qy`."""
    x0, x1, fx = bilinear_cell(qx, width)
    y0, y1, fy = bilinear_cell(qy, height)
    upper = (pair * height + y0) * width
    lower = (pair * height + y1) * width
    v00 = image_j[3 * (upper + x0) + channel]
    v01 = image_j[3 * (upper + x1) + channel]
    v10 = image_j[3 * (lower + x0) + channel]
    v11 = image_j[3 * (lower + x1) + channel]
    top = wp.lerp(v00, v01, fx)
    bottom = wp.lerp(v10, v11, fx)
    return wp.lerp(top, bottom, fy), wp.lerp(v01 - v00, v11 - v10, fy), bottom - top
