"""From a prior to the pairs to match: what pairing needs to know about each kind of prior."""

import dataclasses
from typing import Any

import numpy as np

from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import align_robust
from graphgs.structure.cameras import SharedCameras
from graphgs.structure.pairing import Pairs, make_pairs
from graphgs.structure.pairing_config import PairingConfig
from graphgs.structure.prior import Prior, poses_by_name
from graphgs.structure.uncertainty import GPS, UNKNOWN, PoseUncertainty, measured, of_reconstruction

_FEWEST_COMMON = 4  # cameras that a foreign prior shares with our own reconstruction, to bring both into one frame
_DISAGREE = 4.0  # standard deviations per axis; which of two such positions is wrong, nobody knows


def candidate_pairs(
    config: PairingConfig,
    prior: Prior,
    *,
    extra: np.ndarray | None = None,  # [Q, 2] int into the prior's names: a user's own pairs
    reporter: Reporter,
    threads: int,
) -> Pairs:
    """Concentric, filtered pairs of the placed photos; look-alikes and file neighbours of those without a pose."""
    names = np.array(prior.names, dtype=object)
    placed, unplaced = np.flatnonzero(prior.placed), np.flatnonzero(~prior.placed)
    evidence: dict[str, Any] = {"rotations": prior.rotations[placed]}
    if prior.source == "sequence":
        config = dataclasses.replace(config, pairs="sequential")
    elif prior.source in ("auto", "given"):
        evidence |= _own_evidence(prior)
    else:
        evidence |= _foreign_evidence(prior)
    if not (prior.oriented or "judged" in evidence):
        config = dataclasses.replace(config, filter="none")
    row = np.empty(len(names), dtype=np.int64)
    row[placed], row[unplaced] = np.arange(len(placed)), len(placed) + np.arange(len(unplaced))
    in_order = np.stack([np.arange(len(names) - 1), np.arange(1, len(names))], axis=1)
    more = [prior.similar_pairs(unplaced), in_order[np.isin(in_order, unplaced).any(1)]]
    return make_pairs(
        config,
        list(names[placed]),
        centers=prior.centers[placed],
        fov_deg=fields_of_view(prior.cameras)[placed],
        unplaced=list(names[unplaced]),
        extra=row[np.concatenate([*more, *([] if extra is None else [extra])])],
        reporter=reporter,
        threads=threads,
        **evidence | {"uncertainty": _as_set(config, evidence.get("uncertainty"))},
    )


def fields_of_view(shared: SharedCameras) -> np.ndarray:
    """[N, 2] degrees per photo, horizontal and vertical, distortion left out."""
    per_camera = []
    for camera in shared.cameras:
        fx, fy, _, _ = camera.focal_and_center
        half = np.arctan([camera.width / (2 * fx), camera.height / (2 * fy)])
        per_camera.append(np.degrees(2 * half))
    return np.array(per_camera)[shared.camera_ids]


def _own_evidence(prior: Prior) -> dict[str, Any]:
    """The poses are those of the reconstruction that its points belong to."""
    if prior.reconstruction is None or len(prior.reconstruction.points) == 0:
        return {}
    names = _placed_names(prior)
    points, visible = _points(prior.reconstruction, names)
    return {"points": points, "visible": visible, "uncertainty": of_reconstruction(prior.centers[prior.placed])}


def _foreign_evidence(prior: Prior) -> dict[str, Any]:
    """The poses are from elsewhere: our own reconstruction, carried into their frame, lends its points and shows how
    far the poses are off. Positions alone (GPS) get its rotations too, where it has them and agrees with the place."""
    own, names = prior.reconstruction, _placed_names(prior)
    if own is None:
        return {}
    common, rotations, centers = poses_by_name(names, own)
    if common.sum() < _FEWEST_COMMON:
        return {}
    prior_from_own = align_robust(centers[common], prior.centers[prior.placed][common])
    own = own.transformed(prior_from_own)
    _, rotations, centers = poses_by_name(names, own)
    points, visible = _points(own, names)
    evidence: dict[str, Any] = {"points": points, "visible": visible} if len(points) else {}
    given = prior.rotations[prior.placed][common], prior.centers[prior.placed][common]
    if not prior.oriented:
        off = measured(rotations[common], given[1], rotations[common], centers[common])
        sure = PoseUncertainty(GPS.rotation, max(GPS.position, off.position))
        agree = np.linalg.norm(centers - prior.centers[prior.placed], axis=1) <= _DISAGREE * sure.position
        return evidence | {"rotations": rotations, "judged": common & agree, "uncertainty": sure}
    off = measured(*given, rotations[common], centers[common])
    floor = of_reconstruction(given[1])
    return evidence | {"uncertainty": PoseUncertainty(*np.maximum(off, floor))}


def _placed_names(prior: Prior) -> tuple[str, ...]:
    return tuple(name for name, placed in zip(prior.names, prior.placed, strict=True) if placed)


def _points(reconstruction: Reconstruction, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """(points [K, 3], visible [V, 2]: index into `names`, point) of a reconstruction."""
    index = {name: k for k, name in enumerate(names)}
    row = np.array([index.get(name, -1) for name in reconstruction.names], dtype=np.int64)
    camera = row[reconstruction.track_images]
    point = np.repeat(np.arange(len(reconstruction.points)), reconstruction.track_lengths)
    return reconstruction.points, np.stack([camera, point], axis=1)[camera >= 0]


def _as_set(config: PairingConfig, known: PoseUncertainty | None) -> PoseUncertainty | None:
    """What the user says about the poses, before what is known."""
    if config.rotation_sigma_deg is None and config.position_sigma is None:
        return known
    rotation, position = known or UNKNOWN
    if config.rotation_sigma_deg is not None:
        rotation = float(np.radians(config.rotation_sigma_deg))
    if config.position_sigma is not None:
        position = config.position_sigma
    return PoseUncertainty(rotation, position)
