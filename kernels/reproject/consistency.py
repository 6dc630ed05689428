"""Reproject the pixels of image i into image j and compare colours: one thread per pixel, on every device.

The derivatives in colour and depth of image i come out of the same pass; image j and the cameras have none.
"""

from dataclasses import dataclass
from typing import Any

import warp as wp

from graphgs.kernels.launch import launch_range
from graphgs.kernels.reduce import sum_rows, total
from graphgs.kernels.reproject.geometry import land, lands_inside, seen_depth, seen_value

wp.set_module_options({"enable_backward": False, "max_unroll": 0})

ROBUST_EPS = wp.constant(1e-3)  # [intensity] below it the robust L1 turns quadratic (Charbonnier)
MIN_PIXELS = 4096  # fewer are not worth a launch of their own


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
    min_alpha: Any,
    depth_tolerance: Any,
):
    """Whether the pixel has a match, then what `land` returns."""
    x = type(min_alpha)(index % width_i) + type(min_alpha)(0.5)
    y = type(min_alpha)((index / width_i) % height_i) + type(min_alpha)(0.5)
    pair = index / (width_i * height_i)
    zero = type(min_alpha)(0.0)
    depth = type(min_alpha)(1.0)
    valid = True
    if unit_depth == 0:
        depth = depth_i[index]
        valid = depth > zero and alpha_i[index] >= min_alpha
    qx, qy, z, d_qx, d_qy = land(pixel_map, pair, x, y, depth)
    valid = valid and z > zero and lands_inside(qx, qy, height_j, width_j)
    if valid and unit_depth == 0:
        # Forward-backward check: the point that camera j sees at q lies at depth `seen` on the ray of ours at depth z,
        # so |seen - z| / z is the distance between the two, in units of the distance from the camera: free of scale.
        seen = seen_depth(depth_j, pair, qx, qy, height_j, width_j)
        valid = seen > zero and wp.abs(seen - z) <= depth_tolerance * z
    return valid, qx, qy, z, d_qx, d_qy


@wp.kernel
def reproject_pixels(
    first: int,
    # Image i
    depth_i: wp.array[Any],  # [C Hi Wi]
    alpha_i: wp.array[Any],  # [C Hi Wi]
    height_i: int,
    width_i: int,
    # Image j
    depth_j: wp.array[Any],  # [C Hj Wj]
    height_j: int,
    width_j: int,
    # Cameras and thresholds
    pixel_map: wp.array[Any],  # [C 12]
    unit_depth: int,  # 1: the printed geometry, a ray of depth 1 and no masks but the image's bounds
    limits: wp.array[Any],  # [2] least alpha, depth tolerance
    # Out
    coords: wp.array[Any],  # [C Hi Wi 2] px in image j
    depths: wp.array[Any],  # [C Hi Wi] in camera j
    matched: wp.array[Any],  # [C Hi Wi] 1 or 0
):
    index = first + wp.tid()
    valid, qx, qy, z, _d_qx, _d_qy = match_pixel(
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
        limits[0],
        limits[1],
    )
    coords[2 * index] = qx
    coords[2 * index + 1] = qy
    depths[index] = z
    matched[index] = wp.where(valid, z.dtype(1.0), z.dtype(0.0))


@wp.kernel
def compare_reprojected(
    first: int,
    # Image i
    depth_i: wp.array[Any],  # [C Hi Wi]
    alpha_i: wp.array[Any],  # [C Hi Wi]
    height_i: int,
    width_i: int,
    # Image j
    depth_j: wp.array[Any],  # [C Hj Wj]
    height_j: int,
    width_j: int,
    # Cameras and thresholds
    pixel_map: wp.array[Any],  # [C 12]
    unit_depth: int,
    limits: wp.array[Any],  # [2] least alpha, depth tolerance
    # Colours
    image_i: wp.array[Any],  # [C Hi Wi 3]
    image_j: wp.array[Any],  # [C Hj Wj 3]
    # Out
    residuals: wp.array[Any],  # [C Hi Wi] summed over the channels, 0 where there is no match
    matched: wp.array[Any],  # [C Hi Wi] 1 or 0
    slopes_image: wp.array[Any],  # [C Hi Wi 3] derivative of the residual in the colours of image i
    slopes_depth: wp.array[Any],  # [C Hi Wi] and in its depth
):
    index = first + wp.tid()
    valid, qx, qy, _z, d_qx, d_qy = match_pixel(
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
        limits[0],
        limits[1],
    )
    zero = image_i.dtype(0.0)
    one = image_i.dtype(1.0)
    eps = image_i.dtype(ROBUST_EPS)
    pair = index / (width_i * height_i)
    residual = image_i.dtype(0.0)
    slope_depth = image_i.dtype(0.0)
    for channel in range(3):
        slope = image_i.dtype(0.0)
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
    residuals[index] = residual
    slopes_depth[index] = slope_depth
    matched[index] = wp.where(valid, one, zero)


for _real in (wp.float32, wp.float64):
    _values = wp.array(dtype=_real, ndim=1)
    _common = [int, _values, _values, int, int, _values, int, int, _values, int, _values]
    wp.overload(reproject_pixels, [*_common, *[_values] * 3])
    wp.overload(compare_reprojected, [*_common, *[_values] * 6])


@dataclass(frozen=True)
class DepthPair:
    """C pairs of depth images and what leads from one to the other; every array flat, of one float type."""

    depth_i: wp.array  # [C Hi Wi]
    alpha_i: wp.array  # [C Hi Wi]
    size_i: tuple[int, int]  # height, width [px]
    depth_j: wp.array  # [C Hj Wj]
    size_j: tuple[int, int]
    pixel_map: wp.array  # [C 12], see geometry.py
    unit_depth: bool
    limits: wp.array  # [2] least alpha, depth tolerance

    def _inputs(self) -> list:
        return [
            *(self.depth_i, self.alpha_i, *self.size_i),
            *(self.depth_j, *self.size_j),
            *(self.pixel_map, int(self.unit_depth), self.limits),
        ]


def reproject_depth(
    depths: DepthPair,
    coords: wp.array,  # out, [C Hi Wi 2] px in image j
    depths_j: wp.array,  # out, [C Hi Wi] in camera j
    matched: wp.array,  # out, [C Hi Wi] 1 or 0
    *,
    threads: int = 1,
) -> None:
    launch_range(
        reproject_pixels,
        depths.depth_i.shape[0],
        inputs=depths._inputs(),
        outputs=[coords, depths_j, matched],
        device=depths.depth_i.device,
        threads=threads,
        min_chunk=MIN_PIXELS,
    )


def compare_views(
    depths: DepthPair,
    image_i: wp.array,  # [C Hi Wi 3]
    image_j: wp.array,  # [C Hj Wj 3]
    slopes_image: wp.array,  # out, [C Hi Wi 3] derivative of the residual's sum in image_i
    slopes_depth: wp.array,  # out, [C Hi Wi] and in depth_i
    sums: wp.array,  # out, [2] float64: residuals over all channels, matched pixels
    *,
    threads: int = 1,
) -> None:
    values = [wp.empty_like(depths.depth_i) for _ in range(2)]  # residuals, matched
    device = depths.depth_i.device
    launch_range(
        compare_reprojected,
        depths.depth_i.shape[0],
        inputs=[*depths._inputs(), image_i, image_j],
        outputs=[*values, slopes_image, slopes_depth],
        device=device,
        threads=threads,
        min_chunk=MIN_PIXELS,
    )
    width = depths.size_i[1]
    rows = depths.depth_i.shape[0] // width
    row_sums = wp.empty(2 * rows, dtype=wp.float64, device=device)
    for column, value in enumerate(values):
        sum_rows(value, row_sums[column * rows : (column + 1) * rows], width=width, threads=threads)
    total(row_sums, sums)
