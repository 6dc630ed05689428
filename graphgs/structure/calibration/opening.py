"""Parameters of the lenses opened step by step, each believed only if two witnesses agree.

The first is the covariance of the adjustment in which it is free (`information`), the second are tracks that were kept
out of it. A parameter that the photos leave open is held: at what EXIF or the user says or a typical value, moved
towards what the photos say as far as their uncertainties allow.
"""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.calibration.belief import Calibration, Held, Step
from graphgs.structure.calibration.consequence import shape_change
from graphgs.structure.calibration.information import (
    LensInformation,
    groups_by_place,
    lens_information,
)
from graphgs.structure.calibration.lens import COORDINATES, PARAMETERS, LensStart, opened
from graphgs.structure.calibration.projection import LENS
from graphgs.structure.calibration.tracks import errors_of, split_tracks
from graphgs.structure.calibration.trials import Trials

# Of the distance from the principal point at an image's corner; for the principal point, of the focal length. Where
# photos hardly tell, the true error was four times the group-robust deviation: half a per cent then means two. A focal
# length scales the whole scene along the viewing direction, the others only where the image's corners look.
LARGEST_DEVIATION = {"focal": 0.005, "principal_point": 0.01, "k1": 0.01, "k2": 0.01}
_TRUE_ERROR = 4.0
_CANDIDATES = (("focal",), ("k1",), ("principal_point",), ("k1", "k2"))  # opened together; the order of their weight
_RADII = (0.7, 1.0)  # of the corner's distance, where the effect of distortion is looked at
_FAR_OFF_CENTER = 0.1  # of the longer side: a principal point further out is not believed
_FOCAL_RANGE = (0.3, 4.0)  # of the longer side: beyond, no lens of photography is left
_LARGEST_BENDING = 0.5  # of the distance from the centre at the corner, by distortion
_FEWEST_TRACKS = 30  # held out
# How far off a lens may be that nothing is known of, one standard deviation: relative for a focal length, in focal
# lengths for the principal point, at the corner for distortion.
_TOLD = {"given": 0.002, "EXIF": 0.03, "typical": 0.3}
_WORST = {"principal_point": 0.01, "k1": 0.03, "k2": 0.03}


@dataclass
class _State:
    """The last trial whose parameters are all believed."""

    model: Reconstruction
    folder: Path
    errors: np.ndarray  # [B] of the held-out tracks
    believed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Estimate:
    """A trial with some parameters free."""

    model: Reconstruction
    known: LensInformation
    wanted: tuple[str, ...]


def self_calibrate(
    trials: Trials,
    model: Reconstruction,  # as their folder has it
    starts: tuple[LensStart, ...],  # per camera of the model
    *,
    seed: int,
) -> tuple[Calibration, Reconstruction]:
    """(what the tracks of a model say of its lenses, its poses with those lenses). The model itself stays as it is."""
    split = split_tracks(model, seed=seed)
    start = tuple(opened(s.camera, ()) for s in starts)
    if len(split.held_out) < _FEWEST_TRACKS:
        return Calibration(start, ()), model
    groups = groups_by_place(model.points[split.held_out])
    base, folder = trials.run("start", start, (), tracks=split.adjusted)
    state = _State(base, folder, errors_of(base, model, split.held_out))
    steps: dict[tuple[str, ...], Step] = {}
    estimates: dict[tuple[str, ...], Estimate] = {}
    changed = True
    while changed:
        changed = False
        for candidate in _CANDIDATES:
            if candidate != ("focal",) and "focal" not in state.believed and any(s.origin == "typical" for s in starts):
                continue  # they would only make up for a focal length that may be far off
            wanted = tuple(p for p in PARAMETERS if p in (*state.believed, *candidate))
            if wanted == state.believed or (candidate in steps and steps[candidate].beside == state.believed):
                continue  # believed already, or nothing new since it was tried
            cameras = tuple(opened(camera, wanted) for camera in state.model.cameras)
            tried, its_folder = trials.run("_".join(wanted), cameras, wanted, start=state.folder)
            known = lens_information(tried)
            errors = errors_of(tried, model, split.held_out)
            steps[candidate] = _judged(candidate, wanted, tried, known, state, errors, groups)
            estimates[candidate] = Estimate(tried, known, wanted)
            if steps[candidate].believed:
                state = _State(tried, its_folder, errors, wanted)
                changed = True
    return _concluded(state, steps, estimates, starts), state.model


def _judged(
    candidate: tuple[str, ...],
    wanted: tuple[str, ...],
    tried: Reconstruction,
    known: LensInformation,
    state: _State,
    errors: np.ndarray,
    groups: np.ndarray,
) -> Step:
    deviation = float(deviations(tried, known, candidate, wanted)[_bulk(tried)].max())
    gain, gain_deviation = _gain(state.errors, errors, groups)
    reason = "believed"
    if not _sensible(tried):
        reason = "not a lens"
    elif deviation > LARGEST_DEVIATION[candidate[-1]]:
        reason = "undetermined"
    elif gain < -gain_deviation:
        reason = "held-out tracks fit worse"
    return Step(candidate, state.believed, reason == "believed", deviation, gain, gain_deviation, reason)


def deviations(
    model: Reconstruction, known: LensInformation, candidate: tuple[str, ...], wanted: tuple[str, ...]
) -> np.ndarray:
    """[C] how uncertain a candidate's effect is for each camera, with the `wanted` parameters free: relative to the
    distance from the principal point, where that is largest; for the principal point to the focal length."""
    cameras = len(model.cameras)
    free = np.tile(_coordinates(wanted), cameras)
    result = np.zeros(cameras)
    for radius in _RADII:
        for name in ("center_x", "center_y") if candidate == ("principal_point",) else ("",):
            effects = np.zeros((cameras, cameras, len(LENS)))
            own = _coordinates(candidate) & ([c == name for c in LENS] if name else np.ones(len(LENS), bool))
            effects[range(cameras), range(cameras)] = _effects(model.cameras, radius) * own
            result = np.maximum(result, known.deviation(free, effects.reshape(cameras, -1)))
    return result


def _coordinates(parameters: tuple[str, ...]) -> np.ndarray:
    """[5] bool."""
    names = {c for p in parameters for c in COORDINATES[p]}
    return np.array([c in names for c in LENS])


def _effects(cameras: tuple[Camera, ...], radius: float) -> np.ndarray:
    """[C, 5] what one unit of each lens coordinate does at a share of the corner's distance, relative to the distance
    from the middle; for the principal point, to the focal length."""
    there2 = radius**2 * np.array([(c.width**2 + c.height**2) / (4 * c.focal_and_center[0] ** 2) for c in cameras])
    one = np.ones(len(cameras))
    return np.stack([one, one, one, there2, there2**2], axis=1)


def _bulk(model: Reconstruction) -> np.ndarray:
    """[K] int: the cameras that took the most photos, until nine tenths of the photos are theirs."""
    counts = np.bincount(model.camera_ids, minlength=len(model.cameras))
    order = np.argsort(-counts, kind="stable")
    enough = int(np.searchsorted(np.cumsum(counts[order]), 0.9 * counts.sum())) + 1
    return order[:enough]


def _gain(before: np.ndarray, after: np.ndarray, groups: np.ndarray) -> tuple[float, float]:
    """(by which share the root mean squared error of held-out tracks falls, its standard deviation). Tracks of one
    place err together, so the places are what is counted."""
    finite = np.isfinite(before) & np.isfinite(after)
    if not finite.any():
        return 0.0, np.inf
    change, level = (before - after)[finite], float(before[finite].mean())
    count = np.maximum(np.bincount(groups[finite], minlength=int(groups.max()) + 1), 1e-9)
    means = (np.bincount(groups[finite], change, minlength=len(count)) / count)[count >= 1]
    deviation = float(means.std(ddof=1) / np.sqrt(len(means))) if len(means) > 1 else np.inf
    return float(change.mean()) / (2 * level), deviation / (2 * level)


def _sensible(model: Reconstruction) -> bool:
    for camera in model.cameras:
        focal, _, cx, cy = camera.focal_and_center
        side = max(camera.width, camera.height)
        away = max(abs(cx - camera.width / 2), abs(cy - camera.height / 2)) / side
        corner2 = (camera.width**2 + camera.height**2) / (4 * focal**2)
        k1, k2 = (*camera.distortion, 0.0, 0.0)[:2]
        bending = abs(k1 * corner2 + k2 * corner2**2)
        if not _FOCAL_RANGE[0] <= focal / side <= _FOCAL_RANGE[1]:
            return False
        if away > _FAR_OFF_CENTER or bending > _LARGEST_BENDING:
            return False
    return True


def _concluded(state: _State, steps, estimates, starts: tuple[LensStart, ...]) -> Calibration:
    """The believed values, and those held with what that means."""
    cameras, held = list(state.model.cameras), []
    for candidate, step in steps.items():
        if step.reason != "undetermined" or not set(candidate).isdisjoint(state.believed):
            continue
        estimate = estimates[candidate]
        each = _TRUE_ERROR * deviations(estimate.model, estimate.known, candidate, estimate.wanted)
        if candidate == ("focal",):
            for k, (start, camera) in enumerate(zip(starts, cameras, strict=True)):
                found, away = estimate.model.cameras[k].focal_and_center[0], float(each[k])
                value, each[k] = _weighed(start, found, away)
                if not _sensible(estimate.model) or step.gain < -step.gain_deviation:
                    # What the photos say does not even suit themselves: it tells how uncertain the start is, no more.
                    value = start.camera.focal_and_center[0]
                    each[k] = min(max(away, abs(float(np.log(found / value)))), _TOLD[start.origin])
                cameras[k] = dataclasses.replace(camera, params=(value, *camera.params[1:]))
            values = tuple(sorted({camera.focal_and_center[0] for camera in cameras}))
        else:
            each, values = np.minimum(each, _WORST[candidate[-1]]), ()
        change = each[:, None] / _effects(state.model.cameras, 1.0) * _coordinates(candidate[-1:])
        shape = shape_change(state.model, lens_information(state.model), change.ravel())
        origin = ", ".join(sorted({start.origin for start in starts}))
        held.append(Held(candidate[-1], values, origin, float(each.max()), shape))
    return Calibration(tuple(cameras), state.believed, tuple(steps.values()), tuple(held))


def _weighed(start: LensStart, found: float, deviation: float) -> tuple[float, float]:
    """(focal length, relative standard deviation): what was told and what the photos say, each by its certainty."""
    told, own = 1.0 / _TOLD[start.origin] ** 2, 1.0 / max(deviation, 1e-6) ** 2
    log = (told * np.log(start.focal) + own * np.log(found)) / (told + own)
    return float(np.exp(log)), float(1.0 / np.sqrt(told + own))
