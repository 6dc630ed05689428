"""Whether two cameras see the same, point by point: the overlap gate as it is defined, without any short cut."""

import numpy as np

COLUMNS, ROWS = 8, 4


def coarse_depths(
    local: np.ndarray,  # [V, 3] points one camera sees, in its frame, all ahead of it
    slope: np.ndarray,  # [2]
) -> tuple[np.ndarray, np.ndarray]:
    """(median depth, 95th percentile) [ROWS, COLUMNS]; a cell without points has those of the nearest that has some."""
    middle, far = np.full((2, ROWS, COLUMNS), np.nan)
    cells = [cell_of(point, slope) for point in local]
    for row in range(ROWS):
        for column in range(COLUMNS):
            depths = [point[2] for point, cell in zip(local, cells, strict=True) if cell == (row, column)]
            if depths:
                middle[row, column], far[row, column] = np.percentile(depths, [50, 95])
    filled = np.argwhere(np.isfinite(middle))
    for row, column in np.argwhere(np.isnan(middle)):
        step = (filled - [row, column])[:, ::-1] / [COLUMNS, ROWS] * slope
        source = tuple(filled[np.argmin((step**2).sum(1).round(12))])
        middle[row, column], far[row, column] = middle[source], far[source]
    return middle, far


def cell_of(point: np.ndarray, slope: np.ndarray) -> tuple[int, int]:
    u, v = point[:2] / point[2] / slope
    column = int(np.clip(np.floor((u + 1) / 2 * COLUMNS), 0, COLUMNS - 1))
    return int(np.clip(np.floor((v + 1) / 2 * ROWS), 0, ROWS - 1)), column


def seen_count(
    world: np.ndarray,  # [S, 3] samples of one camera
    rotation: np.ndarray,  # [3, 3] of the other one
    center: np.ndarray,  # [3]
    half_angle: np.ndarray,  # [2] rad
    near: float,
    far: np.ndarray,  # [ROWS, COLUMNS]
    sigma: tuple[float, float],  # of one pose: rad, world units
) -> int:
    """How many of the samples the other camera sees."""
    slope, count = np.tan(half_angle), 0
    rotation_sigma, position_sigma = 0.9 * np.sqrt(2) * np.array(sigma)
    for point in (world - center) @ rotation.T:
        if point[2] <= 0:
            continue
        margin = np.hypot(rotation_sigma, position_sigma / np.linalg.norm(point))
        within = np.abs(point[:2]) <= np.tan(np.minimum(half_angle + margin, np.radians(89))) * point[2]
        limit = far[cell_of(point, slope)]
        count += bool(within.all() and 0.5 * near - position_sigma <= point[2] <= 1.2 * limit + position_sigma)
    return count
