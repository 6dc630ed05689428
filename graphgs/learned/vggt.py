"""Relative poses from models with VGGT's interface (Wang et al. 2025): images in, a pose encoding per image out.

Such a model takes [1, S, 3, H, W] in 0..1 and answers with a dict that holds "pose_enc" [1, S, 9]: translation and
quaternion (x, y, z, w) of camera-from-world, then the two fields of view; and where it has them "depth_conf"
[1, S, H, W].
A file for `--prior learned=FILE.py:estimate`:

    from functools import partial
    from vggt.models.vggt import VGGT
    from graphgs.learned.vggt import relative_poses

    estimate = partial(relative_poses, VGGT.from_pretrained("folder of weights").eval())
"""

from pathlib import Path

import cv2
import numpy as np
import torch
from scipy.spatial.transform import Rotation

from graphgs.structure.relative_poses import RelativePoses

_WIDTH, _PATCH = 518, 14  # [px] as the published weights were trained


def relative_poses(model, paths: list[Path], pairs: np.ndarray, *, device: str = "cpu") -> RelativePoses:
    """[P] poses, two images at a time."""
    images = {k: _image(paths[k]) for k in np.unique(pairs)}
    rotations, translations, confidence = [], [], []
    for i, j in pairs:
        height = min(images[i].shape[0], images[j].shape[0])  # one batch wants one size
        stack = np.stack([_cropped(images[k], height) for k in (i, j)])
        tensor = torch.from_numpy(stack).permute(0, 3, 1, 2)[None].float() / 255.0
        with torch.inference_mode():
            answer = model(tensor.to(device))
        encoded = answer["pose_enc"][0].float().cpu().numpy().astype(np.float64)
        turned = Rotation.from_quat(encoded[:, 3:7]).as_matrix()
        rotation = turned[1] @ turned[0].T
        rotations.append(rotation)
        translations.append(encoded[1, :3] - rotation @ encoded[0, :3])
        confidence.append(float(answer["depth_conf"].float().mean()) if "depth_conf" in answer else 1.0)
    return RelativePoses(np.asarray(pairs), np.array(rotations), np.array(translations), np.array(confidence))


def _image(path: Path) -> np.ndarray:
    """[H, 518, 3] RGB, the height a multiple of the patch."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise OSError(f"{path}: cannot read the decoded photo")
    height = max(_PATCH, round(image.shape[0] * _WIDTH / image.shape[1] / _PATCH) * _PATCH)
    return np.ascontiguousarray(cv2.resize(image, (_WIDTH, height), interpolation=cv2.INTER_AREA)[..., ::-1])


def _cropped(image: np.ndarray, height: int) -> np.ndarray:
    """The middle rows: VGGT's own way with tall pictures."""
    above = (image.shape[0] - height) // 2
    return image[above : above + height]
