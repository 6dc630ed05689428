"""Relative poses from models with DUSt3R's interface (Wang et al. 2024), which MASt3R's have too.

Such a model takes two views {"img": [1, 3, H, W] in -1..1, "true_shape", "idx", "instance"} and answers with
({"pts3d", "conf"}, {"pts3d_in_other_view", "conf"}): a point per pixel of each view, all in the first one's camera.
A file for `--prior learned=FILE.py:estimate`, with the package and the weights the user has:

    from functools import partial
    from dust3r.model import AsymmetricCroCo3DStereo
    from graphgs.learned.pointmaps import relative_poses

    estimate = partial(relative_poses, AsymmetricCroCo3DStereo.from_pretrained("weights.pth").eval())
"""

from pathlib import Path

import cv2
import numpy as np
import torch

from graphgs.structure.relative_poses import RelativePoses

_SIDE = 512  # [px] the longer side the published weights were trained for
_PATCH = 16  # [px] sides are multiples of it
_SAMPLES = 4000  # pixels that vote on a pose
_REPROJECTION_PX = 5.0
_CONFIDENT = 0.5  # the pixels above this quantile of confidence vote


def relative_poses(model, paths: list[Path], pairs: np.ndarray, *, device: str = "cpu") -> RelativePoses:
    """[P] poses by PnP: where the second picture's pixels lie, seen from the first camera, tells where the second one
    is. Its focal length is that of its own points, from the same pair the other way round."""
    images = {k: _image(paths[k]) for k in np.unique(pairs)}
    rotations, translations, confidence = np.tile(np.eye(3), (len(pairs), 1, 1)), np.zeros((len(pairs), 3)), []
    for p, (i, j) in enumerate(pairs):
        _, second = _run(model, images[i], images[j], device)
        own, _ = _run(model, images[j], images[i], device)
        focal = focal_of(own["pts3d"])
        found = _pose(second["pts3d_in_other_view"], second["conf"], focal)
        if found is None:
            confidence.append(0.0)
            continue
        rotations[p], translations[p], share = found
        confidence.append(share * float(second["conf"].mean()))
    return RelativePoses(np.asarray(pairs), rotations, translations, np.array(confidence))


def focal_of(
    points: np.ndarray,  # [H, W, 3] in the camera that took the picture
) -> float:
    """[px] the median over pixels of focal lengths that project a point to its pixel, with the principal point in the
    middle."""
    height, width = points.shape[:2]
    pixel = _pixels(height, width) - [width / 2, height / 2]
    ray = points[..., :2] / np.maximum(points[..., 2:], 1e-9)
    size = (ray**2).sum(-1)
    seen = (points[..., 2] > 0) & (size > 1e-6)
    return float(np.median(((pixel * ray).sum(-1) / np.maximum(size, 1e-12))[seen]))


def _pose(points: np.ndarray, conf: np.ndarray, focal: float) -> tuple[np.ndarray, np.ndarray, float] | None:
    """(rotation [3, 3], translation [3], share of pixels that agree): from the points' frame to this picture's
    camera."""
    height, width = conf.shape
    chosen = np.flatnonzero(conf.ravel() >= np.quantile(conf, _CONFIDENT))
    chosen = chosen[np.linspace(0, len(chosen) - 1, min(_SAMPLES, len(chosen))).astype(int)]
    world = points.reshape(-1, 3)[chosen].astype(np.float64)
    pixel = _pixels(height, width).reshape(-1, 2)[chosen]
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    cv2.setRNGSeed(0)
    ok, turn, translation, inliers = cv2.solvePnPRansac(
        world, pixel, K, None, iterationsCount=200, reprojectionError=_REPROJECTION_PX, flags=cv2.SOLVEPNP_SQPNP
    )
    if not ok or inliers is None or not np.isfinite(translation).all():
        return None
    return cv2.Rodrigues(turn)[0], translation.ravel(), len(inliers) / len(chosen)


def _run(model, first: np.ndarray, second: np.ndarray, device: str) -> tuple[dict, dict]:
    views = [_view(image, index, device) for index, image in enumerate((first, second))]
    with torch.inference_mode():
        answers = model(*views)
    return tuple({key: value[0].float().cpu().numpy() for key, value in answer.items()} for answer in answers)


def _view(image: np.ndarray, index: int, device: str) -> dict:
    tensor = torch.from_numpy(image).permute(2, 0, 1)[None].float() / 127.5 - 1.0
    shape = torch.tensor([image.shape[:2]], dtype=torch.int32)
    return {"img": tensor.to(device), "true_shape": shape, "idx": [index], "instance": [str(index)]}


def _image(path: Path) -> np.ndarray:
    """[H, W, 3] RGB at the size such models take."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise OSError(f"{path}: cannot read the decoded photo")
    scale = _SIDE / max(image.shape[:2])
    size = [max(_PATCH, round(side * scale / _PATCH) * _PATCH) for side in image.shape[1::-1]]
    return np.ascontiguousarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA)[..., ::-1])


def _pixels(height: int, width: int) -> np.ndarray:
    """[H, W, 2] pixel centres, px."""
    y, x = np.mgrid[:height, :width]
    return np.stack([x + 0.5, y + 0.5], axis=-1)
