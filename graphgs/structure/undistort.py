"""From photos to pinhole views at the training size: one resampling by area, then one by OpenCV's remap."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from graphgs.errors import DiskError
from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.views import Views
from graphgs.sources.photos import Photo, Photos
from graphgs.structure.config import StructureConfig

_BORDER_SAMPLES = 64  # points along each side of the image
_WIDEST_FISHEYE = np.tan(np.radians(60.0))  # half-widths of a fisheye's pinhole view end here: beyond, corners smear
_NO_DISTORTION = 1e-12
_SANE_ZOOM = 3.0  # more than this factor between a border's ray and that of an undistorted lens is not believed


@dataclass(frozen=True)
class Undistortion:
    """How the pixels of one camera become those of a pinhole camera of the same size."""

    camera: Camera  # PINHOLE, at the training size
    map_x: np.ndarray | None  # [H, W] float32 in OpenCV's pixel coordinates (centres at integers); None: nothing to do
    map_y: np.ndarray | None
    valid: np.ndarray | None  # [H, W] uint8, 255 where the photo has a pixel; None: everywhere


def undistort(
    config: StructureConfig,
    photos: Photos,
    reconstruction: Reconstruction,
    folder: Path,
    *,
    reporter: Reporter,
    threads: int,
) -> Views:
    """Write the undistorted photos of the reconstruction to images/ below `folder`, masks to masks/, and return the
    views. The long side is at most `config.max_side`. The same files for any number of threads."""
    index_of = {name: k for k, name in enumerate(photos.names)}
    rows = [index_of[name] for name in reconstruction.names]
    plans = [undistortion(_reduced(camera, config.max_side)) for camera in reconstruction.cameras]
    chosen = [plans[camera] for camera in reconstruction.camera_ids]
    (folder / "images").mkdir(parents=True, exist_ok=True)
    (folder / "masks").mkdir(exist_ok=True)

    def work(k: int) -> tuple[str, str | None]:
        return _write(photos.folder, photos.photos[rows[k]], chosen[k], folder, f"{rows[k]:06d}.png")

    written = []
    with ThreadPoolExecutor(threads) as pool:
        for done, files in enumerate(pool.map(work, range(len(rows))), 1):
            written.append(files)
            reporter.progress(done, len(rows), "undistorting")
    missing = sorted(set(np.flatnonzero(photos.is_test)) - set(rows))
    return Views(
        folder=folder,
        names=reconstruction.names,
        images=tuple(image for image, _ in written),
        masks=tuple(mask for _, mask in written),
        sizes=np.array([[plan.camera.width, plan.camera.height] for plan in chosen], dtype=np.int64).reshape(-1, 2),
        Ks=np.array([plan.camera.K for plan in chosen]).reshape(-1, 3, 3),
        viewmats=reconstruction.viewmats,
        is_test=photos.is_test[rows],
        missing_test=tuple(photos.names[k] for k in missing),
    )


def undistortion(camera: Camera) -> Undistortion:
    """The pinhole camera of the same size that shows as much as it can without blank pixels, and the maps to it.

    A barrel's corners are cut off and a pincushion's edges filled by choosing the focal lengths, as COLMAP does with
    blank_pixels = 0. Where the lens model folds over within the photo, what lies beyond the fold is masked."""
    if np.abs(camera.distortion).max(initial=0.0) < _NO_DISTORTION and not camera.is_fisheye:
        return Undistortion(Camera.pinhole(camera.width, camera.height, *camera.focal_and_center), None, None, None)
    pinhole = _inscribed(camera)
    shifted, target = _opencv_matrix(camera), _opencv_matrix(pinhole)
    make_maps = cv2.fisheye.initUndistortRectifyMap if camera.is_fisheye else cv2.initUndistortRectifyMap
    size = (pinhole.width, pinhole.height)
    map_x, map_y = make_maps(shifted, camera.distortion, np.eye(3), target, size, cv2.CV_32FC1)
    # Half a pixel beyond the outermost centres is still inside the photo; remap repeats the edge there.
    inside = (map_x >= -0.5) & (map_x <= camera.width - 0.5) & (map_y >= -0.5) & (map_y <= camera.height - 0.5)
    inside &= _radii(pinhole) < _fold(camera)
    return Undistortion(pinhole, map_x, map_y, None if inside.all() else inside.astype(np.uint8) * 255)


def _inscribed(camera: Camera) -> Camera:
    """The pinhole camera whose image is the largest rectangle around the principal point in the undistorted one."""
    fx, fy, cx, cy = camera.focal_and_center
    width, height = camera.width, camera.height
    t = np.linspace(0.0, 1.0, _BORDER_SAMPLES)
    zeros, ones = np.zeros_like(t), np.ones_like(t)
    left, right = np.stack([zeros, t * height], 1), np.stack([ones * width, t * height], 1)
    top, bottom = np.stack([t * width, zeros], 1), np.stack([t * width, ones * height], 1)
    rays = {side: image_rays(camera, points) for side, points in zip("lrtb", (left, right, top, bottom), strict=True)}
    half = {
        "l": (-rays["l"][:, 0]).min(),
        "r": rays["r"][:, 0].min(),
        "t": (-rays["t"][:, 1]).min(),
        "b": rays["b"][:, 1].min(),
    }
    limit = _WIDEST_FISHEYE if camera.is_fisheye else np.inf
    nominal = {"l": cx / fx, "r": (width - cx) / fx, "t": cy / fy, "b": (height - cy) / fy}
    # Where the border has no ray, for the model folds before it, the solver's answer is anything at all.
    half = {
        side: min(value, limit) if nominal[side] / _SANE_ZOOM < value < nominal[side] * _SANE_ZOOM else nominal[side]
        for side, value in half.items()
    }
    # One scale for both axes keeps pixels square, so the larger of the two wins: nothing outside the photo is shown.
    scale_x = max(cx / (fx * half["l"]), (width - cx) / (fx * half["r"]))
    scale_y = max(cy / (fy * half["t"]), (height - cy) / (fy * half["b"]))
    scale = max(scale_x, scale_y)
    return Camera.pinhole(width, height, fx * scale, fy * scale, cx, cy)


def _radii(camera: Camera) -> np.ndarray:
    """[H, W] distance of a pinhole camera's pixel rays from its axis, at unit depth."""
    fx, fy, cx, cy = camera.focal_and_center
    x, y = (np.arange(camera.width) + 0.5 - cx) / fx, (np.arange(camera.height) + 0.5 - cy) / fy
    return np.hypot(x[None, :], y[:, None])


def _fold(camera: Camera) -> float:
    """The radius at unit depth where the lens model turns back towards the middle; beyond, it shows things twice."""
    r = np.linspace(0.0, 10.0, 10_001)
    if camera.is_fisheye:
        theta = np.arctan(r)
        k1, k2, k3, k4 = camera.distortion
        bent = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
    else:
        k1, k2, _, _, k3, k4, k5, k6 = np.pad(camera.distortion, (0, 8 - len(camera.distortion)))
        r2 = r * r
        bent = r * (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    turns = np.flatnonzero(np.diff(bent) <= 0)
    return float(r[turns[0]]) if len(turns) else np.inf


def image_rays(camera: Camera, points: np.ndarray) -> np.ndarray:
    """[M, 2] undistorted coordinates at unit depth of image points [M, 2] px."""
    undo = cv2.fisheye.undistortPoints if camera.is_fisheye else _undistort_points
    return undo(points[:, None].astype(np.float64), camera.K, camera.distortion)[:, 0]


def _undistort_points(points: np.ndarray, K: np.ndarray, distortion: np.ndarray) -> np.ndarray:
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)  # the default of 5 steps misses by pixels
    undo = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)  # one function since OpenCV 5
    return undo(points, K, distortion, R=np.eye(3), P=np.eye(3), criteria=stop)


def _opencv_matrix(camera: Camera) -> np.ndarray:
    """The intrinsic matrix in OpenCV's coordinates: its pixel centres are integers, ours lie at +0.5."""
    K = camera.K
    K[0, 2] -= 0.5
    K[1, 2] -= 0.5
    return K


def _reduced(camera: Camera, max_side: int | None) -> Camera:
    """The camera at the training size."""
    longer = max(camera.width, camera.height)
    if max_side is None or longer <= max_side:
        return camera
    scale = max_side / longer
    return camera.scaled_to(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))


def _write(source: Path, photo: Photo, plan: Undistortion, folder: Path, file: str) -> tuple[str, str | None]:
    """Write one view's image, and its mask if any pixel is to be ignored. Returns their paths relative to `folder`."""
    image = cv2.imread(str(source / photo.pixels), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise OSError(f"{source / photo.pixels}: cannot read the decoded photo")
    size = (plan.camera.width, plan.camera.height)
    if image.shape[1::-1] != size:
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    if plan.map_x is not None:
        image = cv2.remap(image, plan.map_x, plan.map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    _png(folder / "images" / file, image)
    mask = _mask(source, photo, plan, size)
    if mask is None:
        return f"images/{file}", None
    _png(folder / "masks" / file, mask)
    return f"images/{file}", f"masks/{file}"


def _mask(source: Path, photo: Photo, plan: Undistortion, size: tuple[int, int]) -> np.ndarray | None:
    """[H, W] uint8, 0 = ignore; None where every pixel counts."""
    mask = plan.valid
    if photo.mask is not None:
        own = cv2.imread(str(source / photo.mask), cv2.IMREAD_GRAYSCALE)
        if own is None:
            raise OSError(f"{source / photo.mask}: cannot read the mask")
        own = np.where(own > 127, 255, 0).astype(np.uint8)
        if own.shape[1::-1] != size:
            own = cv2.resize(own, size, interpolation=cv2.INTER_AREA)
            own[own < 255] = 0  # a training pixel counts only if all that it is made of does
        if plan.map_x is not None:
            own = cv2.remap(own, plan.map_x, plan.map_y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
        mask = own if mask is None else np.minimum(own, mask)
    return mask


def _png(path: Path, pixels: np.ndarray) -> None:
    if not cv2.imwrite(str(path), pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1]):
        raise DiskError(f"{path}: could not be written", hint="is the disk full or the folder read-only?")
