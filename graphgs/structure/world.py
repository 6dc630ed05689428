"""The frame of the final world: metres and compass directions where GPS or a rig's known baseline gives them.

With GPS x is east, y north and z up, in metres, with the origin at the median of the positions given. GPS of a phone
is off by metres, and a drive along one street says nothing about the roll around it: so the photos' own idea of "up" is
weighed in, as one more measurement of 10 degrees.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import Similarity, align_robust
from graphgs.structure.prior import Prior
from graphgs.structure.rigs import RigPose

_FEWEST_POSITIONS = 3
_UP_RAD = np.radians(10.0)  # how well the photos' mean "up" is known, if they are held level at all
_LEVEL = 0.7  # length of the mean of all cameras' "up" below which they are not
_ROUNDS = 4  # of fitting and judging how far off GPS is
_SIGMA_M = 0.01  # smallest believable error of a position: also differential GPS has one
_OUTLIER = 5.0  # standard deviations
_GAUSSIAN = 1.4826  # standard deviation of a normal distribution, in medians of its absolute values


@dataclass(frozen=True)
class WorldFrame:
    """What the world's units and axes mean, and how well they fit."""

    scale_from: str  # gps | rig
    compass: bool  # x east, y north, z up; otherwise axes are arbitrary
    origin: tuple[float, float, float] | None = None  # latitude, longitude [deg], altitude [m]
    used: int = 0  # photos with a GPS position that agrees
    rejected: tuple[str, ...] = ()  # photos whose GPS position does not
    median_m: float | None = None  # distance of a camera from its GPS position, over all that have one
    horizontal_median_m: float | None = None
    worst_m: float | None = None
    worst: str = ""  # the photo it belongs to
    scale_deviation: float | None = None  # relative standard deviation of the scale

    def describe(self) -> str:
        """One line."""
        if not self.compass:
            return "the world is in metres, by the rig's baseline"
        figures = f"cameras are {self.median_m:.2f} m from their GPS positions in the median"
        figures += f", {self.worst_m:.2f} m at most ({self.worst})"
        rejected = f"; {len(self.rejected)} positions far off were not used" if self.rejected else ""
        return f"the world is in metres, x east, y north, z up: {figures}{rejected}"


@dataclass(frozen=True)
class GpsFit:
    """A similarity into east, north, up, and how far every camera is from its position then."""

    enu_from_world: Similarity
    offsets: np.ndarray  # [N, 3] m, camera minus GPS
    agrees: np.ndarray  # [N] bool
    scale_deviation: float


def settled(
    reconstruction: Reconstruction,
    prior: Prior,
    rigs: tuple[RigPose, ...],
    *,
    baseline_m: float | None,
) -> tuple[Reconstruction, tuple[RigPose, ...], WorldFrame | None, str]:
    """(reconstruction, rigs, frame, reason) in metres where something says how long one is: a known baseline before
    GPS, GPS for the axes. None: nothing did, and everything is as it was; then the reason says what was wrong, if
    anything was asked for."""
    reasons, frame = [], None
    if baseline_m is not None:
        scale, reason = _rig_scale(rigs, baseline_m)
        reasons.append(reason)
        if scale is not None:
            reconstruction = reconstruction.transformed(Similarity(scale, np.eye(3), np.zeros(3)))
            rigs = tuple(rig.scaled(scale) for rig in rigs)
            frame = WorldFrame("rig", compass=False)
    if prior.source == "gps":
        row = {name: k for k, name in enumerate(prior.names)}
        placed = np.array([row[name] for name in reconstruction.names], dtype=np.int64)
        known = prior.placed[placed]
        fit = None
        if known.sum() >= _FEWEST_POSITIONS:
            ups = -reconstruction.rotations[:, 1]
            gps = prior.centers[placed[known]]
            fit = fit_gps(reconstruction.centers[known], ups, gps, metric=frame is not None)
        if fit is None:
            reasons.append(f"GPS of {known.sum()} placed photos cannot orient the scene: 3 apart from each other can")
        else:
            names = [name for name, k in zip(reconstruction.names, known, strict=True) if k]
            reconstruction = reconstruction.transformed(fit.enu_from_world)
            rigs = tuple(rig.scaled(fit.enu_from_world.scale) for rig in rigs)
            frame = _described(fit, names, prior.origin, "gps" if frame is None else "rig")
    return reconstruction, rigs, frame, "; ".join(filter(None, reasons))


def fit_gps(
    centers: np.ndarray,  # [N, 3] world
    ups: np.ndarray,  # [M, 3] upward directions of cameras, world
    gps: np.ndarray,  # [N, 3] m: east, north, up
    *,
    metric: bool = False,  # the world is in metres: the scale stays 1
) -> GpsFit | None:
    """The similarity that brings the cameras to their positions, robustly; a minority may be anywhere. None if the
    positions or the cameras all are at one place."""
    if min(np.ptp(centers, axis=0).max(), np.ptp(gps, axis=0).max()) <= 0:
        return None
    up = ups.mean(0)
    level = np.linalg.norm(up) > _LEVEL
    up = up / np.linalg.norm(up) if level else None
    start = align_robust(centers, gps)
    scale = 1.0 if metric else start.scale
    middle = np.median(centers, axis=0)  # fitted around the cameras, or a small turn would move them all
    rotation = _upright(start, centers, gps, up)
    current = (rotation, scale, np.median(gps - scale * (centers - middle) @ rotation.T, axis=0))
    offsets = _moved(current, centers - middle) - gps
    for _ in range(_ROUNDS):
        sigma = np.array([_deviation(offsets[:, :2]), _deviation(offsets[:, :2]), _deviation(offsets[:, 2:])])
        agrees = (np.abs(offsets) < _OUTLIER * sigma).all(1)
        if agrees.sum() < _FEWEST_POSITIONS:
            agrees[:] = True
        current = _refined(current, (centers - middle)[agrees], gps[agrees], sigma, up, metric)
        offsets = _moved(current, centers - middle) - gps
    rotation, scale, translation = current
    spread = np.linalg.norm((gps - gps[agrees].mean(0))[agrees][:, :2])
    return GpsFit(
        Similarity(scale, rotation, translation - scale * rotation @ middle),
        offsets,
        agrees,
        0.0 if metric else float(sigma[0] / max(spread, 1e-12)),
    )


def _upright(start: Similarity, centers: np.ndarray, gps: np.ndarray, up: np.ndarray | None) -> np.ndarray:
    """[3, 3] the rotation of a first fit, with the roll around a straight track that only "up" tells (Wahba 1965)."""
    if up is None:
        return start.rotation
    error = np.linalg.norm(start.apply(centers) - gps, axis=1)
    sigma = max(float(np.median(error)), _SIGMA_M)
    near = error <= _OUTLIER * sigma
    x, y = start.scale * (centers[near] - centers[near].mean(0)), gps[near] - gps[near].mean(0)
    u, _, vt = np.linalg.svd(y.T @ x / sigma**2 + np.outer([0.0, 0.0, 1.0], up) / _UP_RAD**2)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def _refined(current, centers: np.ndarray, gps: np.ndarray, sigma: np.ndarray, up: np.ndarray | None, metric: bool):
    """(rotation, scale, translation) of least weighted error from the current one."""
    rotation, scale, translation = current

    def unpack(x):
        turned = Rotation.from_rotvec(x[:3]).as_matrix() @ rotation
        return turned, scale * (1.0 if metric else np.exp(x[6])), translation + x[3:6]

    def residuals(x):
        moved = unpack(x)
        errors = ((_moved(moved, centers) - gps) / sigma).ravel()
        return errors if up is None else np.concatenate([errors, (moved[0] @ up - [0.0, 0.0, 1.0]) / _UP_RAD])

    return unpack(least_squares(residuals, np.zeros(7), loss="soft_l1", x_scale="jac").x)


def _moved(pose: tuple[np.ndarray, float, np.ndarray], points: np.ndarray) -> np.ndarray:
    rotation, scale, translation = pose
    return scale * points @ rotation.T + translation


def _deviation(offsets: np.ndarray) -> float:
    """[m] robust standard deviation per axis."""
    return max(_GAUSSIAN * float(np.median(np.abs(offsets))), _SIGMA_M)


def _rig_scale(rigs: tuple[RigPose, ...], baseline_m: float) -> tuple[float | None, str]:
    if not rigs:
        return None, "structure.rig_baseline_m was given, but the photos show no rig"
    rig = rigs[0]
    if not rig.rigid or rig.baselines[1] <= 0:
        return None, f"{rig.folders[0]} and {rig.folders[1]} do not keep their distance, which is not used as a scale"
    return baseline_m / float(rig.baselines[1]), ""


def _described(fit: GpsFit, names: list[str], origin, scale_from: str) -> WorldFrame:
    distance = np.linalg.norm(fit.offsets, axis=1)
    return WorldFrame(
        scale_from=scale_from,
        compass=True,
        origin=origin,
        used=int(fit.agrees.sum()),
        rejected=tuple(name for name, ok in zip(names, fit.agrees, strict=True) if not ok),
        median_m=float(np.median(distance)),
        horizontal_median_m=float(np.median(np.linalg.norm(fit.offsets[:, :2], axis=1))),
        worst_m=float(distance.max()),
        worst=names[int(distance.argmax())],
        scale_deviation=fit.scale_deviation,
    )


def plain(frame: WorldFrame | None) -> dict | None:
    """For files and events."""
    return None if frame is None else dataclasses.asdict(frame)


def from_plain(values: dict | None) -> WorldFrame | None:
    """What `plain` made, from a file."""
    if values is None:
        return None
    origin = None if values["origin"] is None else tuple(values["origin"])
    return WorldFrame(**{**values, "origin": origin, "rejected": tuple(values["rejected"])})
