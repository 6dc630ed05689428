"""The mathematics of one Gaussian: its covariance and its EWA projection (EWA Splatting, Zwicker et al. 2002).

Every function takes float32 or float64 (`Any`), so that the same lines pass a float64 gradient check.
"""

from typing import Any

import warp as wp


@wp.func
def rotation_from_quat(
    quat: Any,  # wxyz, need not be unit; the zero quaternion gives the identity
):
    q = wp.normalize(quat)
    one, two = quat.dtype(1.0), quat.dtype(2.0)
    w, x, y, z = q[0], q[1], q[2], q[3]
    return wp.matrix_from_rows(
        wp.vector(one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)),
        wp.vector(two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)),
        wp.vector(two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)),
    )


@wp.func
def split_viewmat(
    viewmat: Any,  # world-to-camera, 4 x 4
):
    """Rotation and translation, camera-from-world."""
    rotation = wp.matrix_from_rows(
        wp.vector(viewmat[0, 0], viewmat[0, 1], viewmat[0, 2]),
        wp.vector(viewmat[1, 0], viewmat[1, 1], viewmat[1, 2]),
        wp.vector(viewmat[2, 0], viewmat[2, 1], viewmat[2, 2]),
    )
    return rotation, wp.vector(viewmat[0, 3], viewmat[1, 3], viewmat[2, 3])


@wp.func
def jacobian_limits(pinhole: Any, width: int, height: int):
    """Smallest and largest x/z and y/z at which the Jacobian is taken: 0.3 fields of view outside (as gsplat)."""
    margin = pinhole.dtype(0.15)  # 0.3 * tan(fov / 2), and tan(fov / 2) = 0.5 * size / focal
    w, h = pinhole.dtype(width), pinhole.dtype(height)
    fx, fy, cx, cy = pinhole[0], pinhole[1], pinhole[2], pinhole[3]
    return wp.vector(
        -(cx + margin * w) / fx,
        (w - cx + margin * w) / fx,
        -(cy + margin * h) / fy,
        (h - cy + margin * h) / fy,
    )


@wp.func
def project_gaussian(
    mean: Any,  # world
    quat: Any,  # wxyz
    scale: Any,  # standard deviations
    rotation: Any,  # camera-from-world
    translation: Any,  # camera-from-world
    pinhole: Any,  # fx, fy, cx, cy [px]
    limits: Any,  # from `jacobian_limits`
):
    """Mean [px], covariance (xx, xy, yy [px^2], and its determinant [px^4]) and depth of the projected Gaussian.

    The projection is linearised where the mean is, but no further out than `limits`: far outside the image the Jacobian
    grows without bound (3DGS clamps to 1.3 fields of view). The clamp moves the Jacobian only, not the mean.
    """
    p = rotation * mean + translation
    z = p[2]
    zero = mean.dtype(0.0)
    fx, fy = pinhole[0], pinhole[1]
    slope_x = wp.clamp(p[0] / z, limits[0], limits[1])
    slope_y = wp.clamp(p[1] / z, limits[2], limits[3])
    row_x = wp.vector(fx / z, zero, -fx * slope_x / z)
    row_y = wp.vector(zero, fy / z, -fy * slope_y / z)

    # Square roots of the covariance: J W R S, so that it stays positive definite in float32.
    root = wp.transpose(rotation * rotation_from_quat(quat) * wp.diag(scale))
    a = root * row_x
    b = root * row_y
    mean2d = wp.vector(fx * p[0] / z + pinhole[2], fy * p[1] / z + pinhole[3])
    # The determinant as a sum of squares (Cauchy-Binet): of a needle, xx yy - xy^2 would leave rounding alone.
    normal = wp.cross(a, b)
    return mean2d, wp.vector(wp.dot(a, a), wp.dot(a, b), wp.dot(b, b), wp.dot(normal, normal)), z


@wp.func
def blur(covariance: Any, eps2d: Any):
    """The covariance with eps2d [px^2] added to its diagonal: no Gaussian falls between pixel centres."""
    determinant = covariance[3] + eps2d * (covariance[0] + covariance[2] + eps2d)
    return wp.vector(covariance[0] + eps2d, covariance[1], covariance[2] + eps2d, determinant)


@wp.func
def conic_from_covariance(covariance: Any):
    """Upper triangle of the inverse [px^-2]."""
    det = covariance[3]
    return wp.vector(covariance[2] / det, -covariance[1] / det, covariance[0] / det)  # det^2 might overflow


@wp.func
def blur_compensation(covariance: Any, blurred: Any):
    """Factor on the opacity that undoes the brightening by `blur` (Mip-Splatting, Yu et al. 2024, Eq. 9)."""
    ratio = covariance[3] / blurred[3]
    result = covariance.dtype(0.0)
    if ratio > covariance.dtype(0.0):  # the square root has no gradient at 0
        result = wp.sqrt(ratio)
    return result
