"""The thresholds of compositing (3DGS, Kerbl et al. 2023; values as in gsplat), used by forward and backward alike."""

import warp as wp

ALPHA_MIN = wp.constant(1.0 / 255.0)  # a fainter contribution is skipped
ALPHA_MAX = wp.constant(0.99)  # keeps 1 - alpha away from 0
TRANSMITTANCE_MIN = wp.constant(1e-4)  # a Gaussian that would leave less light than this, and all behind it, is dropped
TILE_SIZE = wp.constant(16)  # [px]
MAX_SIGMA = wp.constant(3.33)  # [standard deviations] beyond it even opacity 1 is fainter than ALPHA_MIN
MAX_VARIANCE = wp.constant(1.0e12)  # [px^2] a wider Gaussian is not drawn: its conic would be rounding alone, or NaN
MAX_RADIUS = wp.constant(1.0e6)  # [px] keeps a radius inside an int
