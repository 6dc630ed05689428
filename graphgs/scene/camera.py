"""A camera's intrinsics, with COLMAP's model names and parameter order."""

import math
from dataclasses import dataclass

import numpy as np

# Parameter order per model (COLMAP, src/colmap/sensor/models.h): fx[,fy],cx,cy, then distortion.
MODEL_PARAMS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12,
}
ONE_FOCAL = {"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"}


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera. Pixel centres lie at +0.5; x right, y down."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]  # [px] focal length(s) and principal point, then distortion

    def __post_init__(self):
        if self.model not in MODEL_PARAMS:
            raise ValueError(f"camera model {self.model!r}: expected one of {', '.join(MODEL_PARAMS)}")
        if len(self.params) != MODEL_PARAMS[self.model]:
            raise ValueError(f"{self.model}: expected {MODEL_PARAMS[self.model]} parameters, got {len(self.params)}")
        # Plain numbers, so that a camera made from NumPy scalars can be written as JSON.
        object.__setattr__(self, "width", int(self.width))
        object.__setattr__(self, "height", int(self.height))
        object.__setattr__(self, "params", tuple(float(p) for p in self.params))
        if self.width < 1 or self.height < 1:
            raise ValueError(f"{self.model}: expected a size of at least 1x1 px, got {self.width}x{self.height}")
        if not all(math.isfinite(p) for p in self.params) or min(self.focal_and_center[:2]) <= 0:
            raise ValueError(f"{self.model}: expected finite parameters and a positive focal length, got {self.params}")

    @staticmethod
    def pinhole(width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> "Camera":
        return Camera("PINHOLE", width, height, (float(fx), float(fy), float(cx), float(cy)))

    @property
    def K(self) -> np.ndarray:
        """[3, 3] intrinsic matrix in pixels, distortion left out."""
        fx, fy, cx, cy = self.focal_and_center
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def focal_and_center(self) -> tuple[float, float, float, float]:
        p = self.params
        return (p[0], p[0], p[1], p[2]) if self.model in ONE_FOCAL else (p[0], p[1], p[2], p[3])

    @property
    def is_fisheye(self) -> bool:
        return self.model == "OPENCV_FISHEYE"

    @property
    def distortion(self) -> np.ndarray:
        """Distortion in OpenCV's order: [k1,k2,p1,p2[,k3..k6]], or the fisheye's [k1..k4]; empty for a pinhole."""
        p = self.params
        if self.model == "SIMPLE_RADIAL":
            return np.array([p[3], 0.0, 0.0, 0.0])
        if self.model == "RADIAL":
            return np.array([p[3], p[4], 0.0, 0.0])
        return np.array(p[4:], dtype=float)  # OPENCV k1 k2 p1 p2; FISHEYE k1..k4; FULL k1 k2 p1 p2 k3 k4 k5 k6

    def scaled_to(self, width: int, height: int) -> "Camera":
        """The same camera for an image resized to width x height. Distortion is in normalised units and stays."""
        sx, sy = width / self.width, height / self.height
        p = list(self.params)
        if self.model in ONE_FOCAL:
            p[0], p[1], p[2] = p[0] * (sx + sy) / 2, p[1] * sx, p[2] * sy
        else:
            p[0], p[1], p[2], p[3] = p[0] * sx, p[1] * sy, p[2] * sx, p[3] * sy
        return Camera(self.model, width, height, tuple(p))
