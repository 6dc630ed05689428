"""Error pictures: the absolute colour error on a fixed scale, in colours that read in grey as well."""

import cv2
import numpy as np

ERROR_MAX = 0.25  # error at the bright end, white is 1; the same for every run, so that pictures can be compared
IGNORED = (96, 96, 96)  # RGB of pixels a mask leaves out


def error_map(
    truth: np.ndarray,  # [H, W, 3] uint8
    render: np.ndarray,  # [H, W, 3] float in [0, 1]
    mask: np.ndarray | None = None,  # [H, W] bool, False = ignored
) -> np.ndarray:
    """[H, W, 3] uint8 RGB: mean over the channels of |render - truth|, from black (0) to pale yellow (`ERROR_MAX`
    and more)."""
    error = np.abs(render - truth.astype(np.float32) / 255.0).mean(axis=2)
    level = np.nan_to_num(error / ERROR_MAX, nan=1.0).clip(0.0, 1.0)
    colored = _inferno((level * 255.0 + 0.5).astype(np.uint8))
    if mask is not None:
        colored[~mask] = IGNORED
    return colored


def color_stops(count: int) -> list[tuple[int, int, int]]:
    """`count` RGB colours, evenly spaced from the dark to the bright end of the scale."""
    ramp = _inferno(np.linspace(0, 255, count).round().astype(np.uint8)[None])[0]
    return [tuple(int(c) for c in color) for color in ramp]


def _inferno(level: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(cv2.applyColorMap(level, cv2.COLORMAP_INFERNO)[..., ::-1])
