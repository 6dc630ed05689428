"""SIFT features of some images, one file each."""

from pathlib import Path

import cv2
import numpy as np
import pycolmap

from graphgs.structure.colmap_jobs.convert import Progress

_FEW = 0.1  # of the features asked for: the fainter ones are taken, too
_FAINT = 0.3  # of COLMAP's threshold of contrast


def extract(
    root: str,
    images: list[str],  # pixel files below root
    masks: list[str | None],  # mask files below root; 0 = no features here
    out: str,  # folder for <image>.npz: keypoints [F, 4] (x, y, scale, orientation; file px), descriptors [F, 128]
    max_side: int,  # [px] images are reduced to it first
    max_features: int,
    first_octave: int,
    progress: Progress,
) -> dict:
    """SIFT features of some images, one file each; those that have theirs are passed over."""
    cv2.setNumThreads(1)
    extractors = _extractors(max_features, first_octave)
    for count, (name, mask) in enumerate(zip(images, masks, strict=True), 1):
        target = Path(out) / f"{name}.npz"
        if target.exists():  # by a worker that died
            continue
        keypoints, described = _sift(extractors, Path(root), name, mask, max_side, max_features)
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_suffix(".partial.npz")
        np.savez(partial, keypoints=keypoints, descriptors=described)
        partial.rename(target)
        progress(count, len(images))
    return {}


def _extractors(max_features: int, first_octave: int) -> list:
    """SIFT as COLMAP has it, and one that also takes what has little contrast: fields, sand and snow give it a tenth of
    the features of other photos, too few to match anything."""
    made = []
    for share in (1.0, _FAINT):
        options = pycolmap.FeatureExtractionOptions(num_threads=1, use_gpu=False)
        options.sift.max_num_features = max_features
        options.sift.first_octave = first_octave
        options.sift.peak_threshold *= share
        made.append(pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu))
    return made


def _sift(
    extractors: list, root: Path, name: str, mask: str | None, max_side: int, max_features: int
) -> tuple[np.ndarray, np.ndarray]:
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    image = cv2.imread(str(root / name), flags)
    if image is None:
        raise OSError(f"{root / name}: cannot read the decoded photo")
    height, width = image.shape
    scale = min(1.0, max_side / max(height, width))
    if scale < 1.0:
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    found, described = extractors[0].extract_from_uint8_array(image)
    if len(found) < _FEW * max_features:
        found, described = extractors[1].extract_from_uint8_array(image)
    keypoints = pycolmap.keypoints_to_matrix(found)
    keypoints[:, :2] *= (width / image.shape[1], height / image.shape[0])
    keypoints[:, 2] *= width / image.shape[1]
    descriptors = described.data.reshape(-1, 128)
    if mask is not None:
        allowed = cv2.imread(str(root / mask), cv2.IMREAD_GRAYSCALE)
        if allowed is None:
            raise OSError(f"{root / mask}: cannot read the mask")
        columns = np.clip(keypoints[:, 0].astype(int), 0, width - 1)
        rows = np.clip(keypoints[:, 1].astype(int), 0, height - 1)
        keep = allowed[rows, columns] > 127
        keypoints, descriptors = keypoints[keep], descriptors[keep]
    return keypoints, descriptors
