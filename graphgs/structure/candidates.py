"""From a prior to the pairs to match: what pairing needs to know about each kind of prior."""

import dataclasses

import numpy as np

from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.cameras import SharedCameras
from graphgs.structure.pairing import Pairs, make_pairs
from graphgs.structure.pairing_config import PairingConfig
from graphgs.structure.prior import Prior

_DEPTH_PERCENTILES = (2.0, 98.0)  # of a camera's points: outliers must not stretch its frustum
_FEWEST_POINTS = 20  # a camera with fewer takes the depths of all cameras


def candidate_pairs(config: PairingConfig, prior: Prior, *, reporter: Reporter, threads: int) -> Pairs:
    """Concentric, filtered pairs of the placed photos; look-alikes and file neighbours of those without a pose."""
    names = np.array(prior.names, dtype=object)
    placed, unplaced = np.flatnonzero(prior.placed), np.flatnonzero(~prior.placed)
    if prior.source == "sequence":
        config = dataclasses.replace(config, pairs="sequential")
    elif not prior.oriented:
        config = dataclasses.replace(config, filter="none")
    row = np.empty(len(names), dtype=np.int64)
    row[placed], row[unplaced] = np.arange(len(placed)), len(placed) + np.arange(len(unplaced))
    in_order = np.stack([np.arange(len(names) - 1), np.arange(1, len(names))], axis=1)
    extra = np.concatenate([prior.similar_pairs(unplaced), in_order[np.isin(in_order, unplaced).any(1)]])
    same_frame = prior.source in ("auto", "given") and prior.reconstruction is not None
    return make_pairs(
        config,
        list(names[placed]),
        prior.rotations[placed],
        prior.centers[placed],
        fov_deg=fields_of_view(prior.cameras)[placed],
        depth_range=depth_ranges(prior.reconstruction) if same_frame else None,
        unplaced=list(names[unplaced]),
        extra=row[extra],
        reporter=reporter,
        threads=threads,
    )


def fields_of_view(shared: SharedCameras) -> np.ndarray:
    """[N, 2] degrees per photo, horizontal and vertical, distortion left out."""
    per_camera = []
    for camera in shared.cameras:
        fx, fy, _, _ = camera.focal_and_center
        half = np.arctan([camera.width / (2 * fx), camera.height / (2 * fy)])
        per_camera.append(np.degrees(2 * half))
    return np.array(per_camera)[shared.camera_ids]


def depth_ranges(reconstruction: Reconstruction) -> np.ndarray | None:
    """[N, 2] near and far of the points each camera sees, world units; None without points."""
    if len(reconstruction.points) == 0:
        return None
    point = np.repeat(np.arange(len(reconstruction.points)), reconstruction.track_lengths)
    camera = reconstruction.track_images
    depth = (
        np.einsum("tj,tj->t", reconstruction.rotations[camera, 2], reconstruction.points[point])
        + reconstruction.translations[camera, 2]
    )
    camera, depth = camera[depth > 0], depth[depth > 0]
    ranges = np.tile(np.percentile(depth, _DEPTH_PERCENTILES), (len(reconstruction.names), 1))
    for k in range(len(ranges)):
        own = depth[camera == k]
        if len(own) >= _FEWEST_POINTS:
            ranges[k] = np.percentile(own, _DEPTH_PERCENTILES)
    ranges[:, 1] = np.maximum(ranges[:, 1], ranges[:, 0] * 1.01)
    return ranges
