"""Photos of two lenses in one folder that tell nothing of it: tried as two cameras, and believed to be where that fits.

Each photo is asked for the focal length it would like, with the points where they are and its pose free. One lens
scatters by less than a thousandth around one value; of two lenses, those of the longer one ask for more, though the
reconstruction has found a compromise (cameras that zoom are placed as if they had come closer). The division is then
adjusted with two cameras, photos change sides until they stay, and tracks that took no part must fit better.
"""

from dataclasses import dataclass

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.calibration.points import sums
from graphgs.structure.calibration.projection import linearise
from graphgs.structure.calibration.tracks import errors_of, split_tracks
from graphgs.structure.calibration.trials import Trials

_FEWEST_POINTS = 30  # of a photo, to tell its focal length
_FEWEST_PHOTOS = 3  # of a lens
_SCATTER = 0.001  # of the logarithm of a photo's focal length, from which on two lenses are tried
_LEAST_RATIO = 1.04  # of two focal lengths: zoom steps and second lenses are further apart, focusing changes less
_LEAST_GAIN = 0.05  # share of the loss of held-out tracks; a lens more hardly changes it where there is only one
_MOST_TURNS = 10
_LOSS_PX = 2.0
_ROUNDS = 5
_ASKING = 3.0  # deviations


@dataclass(frozen=True)
class TwoLenses:
    """A camera whose photos are of two."""

    apart: np.ndarray  # [K] int: photos of the model that get a camera of their own
    model: Reconstruction  # adjusted so, with the new camera last
    gain: float  # share of the loss of held-out tracks that goes away

    @property
    def ratio(self) -> float:
        """Of the new camera's focal length to that which the other photos keep."""
        other = self.model.camera_of(int(np.setdiff1d(np.arange(len(self.model.names)), self.apart)[0]))
        return self.model.cameras[-1].focal_and_center[0] / other.focal_and_center[0]


def two_lenses(
    trials: Trials,
    model: Reconstruction,  # as their folder has it, with one camera
    *,
    seed: int,
) -> TwoLenses | None:
    """None where one lens explains the photos as well."""
    logs, _ = photo_focals(model)
    known = np.flatnonzero(np.isfinite(logs))
    if len(model.cameras) != 1 or len(known) < 2 * _FEWEST_PHOTOS or logs[known].std() < _SCATTER:
        return None
    long = known[logs[known] > _division(logs[known])]
    split = split_tracks(model, seed=seed)
    if len(split.held_out) < _FEWEST_POINTS:
        return None
    one, _ = trials.run("one_lens", model.cameras, ("focal",), tracks=split.adjusted)
    found, tried = None, set()
    for turn in range(_MOST_TURNS):
        if min(len(long), len(known) - len(long)) < _FEWEST_PHOTOS:
            return None
        start = (*model.cameras, model.cameras[0])
        two, _ = trials.run(f"two_lenses_{turn}", start, ("focal",), tracks=split.adjusted, apart=long)
        before, after = (errors_of(m, model, split.held_out) for m in (one, two))
        finite = np.isfinite(before) & np.isfinite(after)
        found = TwoLenses(long, two, float(1.0 - after[finite].mean() / before[finite].mean()))
        moved = _divided(two, tried)
        if set(moved) == set(long):
            break
        long = moved
    ratio = max(found.ratio, 1.0 / found.ratio)
    return found if ratio >= _LEAST_RATIO and found.gain >= _LEAST_GAIN else None


def photo_focals(model: Reconstruction) -> tuple[np.ndarray, np.ndarray]:
    """([N] logarithm of the focal length that each photo likes, over that of its camera, [N] standard deviation); nan
    where too few points are seen."""
    n = len(model.names)
    point = np.repeat(np.arange(len(model.points)), model.track_lengths)
    images = model.track_images.astype(np.int64)
    parts = linearise(model, images, model.points[point], model.track_xy)
    J = np.concatenate([parts.by_pose, parts.by_lens[:, :, :1]], axis=2)
    enough = np.bincount(images[parts.ahead], minlength=n) >= _FEWEST_POINTS
    step = np.zeros((n, 7))
    for _ in range(_ROUNDS):  # linear in the step, robust in the residuals
        rest = parts.residuals + np.einsum("mij,mj->mi", J, step[images])
        weight = parts.ahead / (1.0 + (rest**2).sum(1) / _LOSS_PX**2)
        weighted = weight[:, None, None] * J
        normal = sums(weighted.transpose(0, 2, 1) @ J, images, n)
        pull = sums(np.einsum("mij,mi->mj", weighted, parts.residuals), images, n)
        scale = np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-30))
        conditioned = normal / scale[:, :, None] / scale[:, None, :] + 1e-9 * np.eye(7)
        step = -np.linalg.solve(conditioned, (pull / scale)[:, :, None])[:, :, 0] / scale
    noise2 = max(float(np.median(parts.residuals[parts.ahead] ** 2)) / 0.455, 1e-6)  # chi squared, one degree
    deviation = np.sqrt(noise2 * np.linalg.inv(conditioned)[:, 6, 6]) / scale[:, 6]
    return np.where(enough, step[:, 6], np.nan), np.where(enough, deviation, np.nan)


def _division(values: np.ndarray) -> float:
    """The value that divides values into two groups of least variance (Otsu 1979), each of photos enough."""
    ordered = np.sort(values)
    places = range(_FEWEST_PHOTOS, len(ordered) - _FEWEST_PHOTOS + 1)
    within = [k * ordered[:k].var() + (len(ordered) - k) * ordered[k:].var() for k in places]
    k = places[int(np.argmin(within))]
    return float(ordered[k - 1] + ordered[k]) / 2


def _divided(two: Reconstruction, tried: set[int]) -> np.ndarray:
    """[K] int: the photos that belong to the new camera. Those that like its focal length better; and, once, those of
    the other that ask for something of it beyond their scatter: a photo that was placed nearer to make up for its lens
    asks for little, and for all once it is placed with its own."""
    new = len(two.cameras) - 1
    shared = int(np.setdiff1d(two.camera_ids, [new])[0])
    logs, deviations = photo_focals(two)
    towards = np.log(two.cameras[new].focal_and_center[0] / two.cameras[shared].focal_and_center[0])
    own = np.where(two.camera_ids == new, towards, 0.0) + np.nan_to_num(logs)
    belongs = np.abs(own - towards) < np.abs(own)
    others = np.flatnonzero((two.camera_ids == shared) & np.isfinite(logs))
    scatter = 1.4826 * np.median(np.abs(logs[others] - np.median(logs[others]))) if len(others) else np.inf
    asked = (logs - np.median(logs[others])) * np.sign(towards)
    asking = [k for k in others if k not in tried and asked[k] > _ASKING * max(scatter, deviations[k])]
    belongs[asking] = True
    tried.update(int(k) for k in asking)
    return np.flatnonzero(belongs)
