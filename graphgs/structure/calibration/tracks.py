"""The tracks a trial is made of and those it is tested on."""

from dataclasses import dataclass

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.calibration.points import Observations, fitted

_PER_PHOTO = (60, 200)  # observations, at least and at most: enough for a lens, a tenth of a whole adjustment's cost
_IN_ALL = 60_000  # of a large set: its photos tell about the same lens
_SHORTEST = 3  # photos of a track; two rays meet nearly anywhere
_HELD_OUT = 10  # every tenth track is kept out of the adjustment, and all that thinning leaves
_MOST_HELD_OUT = 4000


@dataclass(frozen=True)
class Split:
    """Points of a model by index, disjoint."""

    adjusted: np.ndarray  # [A] int
    held_out: np.ndarray  # [B] int


def split_tracks(model: Reconstruction, *, seed: int) -> Split:
    """A thinned set of tracks that gives every photo observations enough; others of the same length are held out."""
    rng = np.random.default_rng(seed)
    wanted = np.full(len(model.names), int(np.clip(_IN_ALL / max(len(model.names), 1), *_PER_PHOTO)))
    offsets, images = model.track_offsets.tolist(), model.track_images
    chosen, rest = [], []
    for count, point in enumerate(rng.permutation(np.flatnonzero(model.track_lengths >= _SHORTEST)).tolist()):
        seen_by = images[offsets[point] : offsets[point + 1]]
        if count % _HELD_OUT and (wanted[seen_by] > 0).any():
            wanted[seen_by] -= 1
            chosen.append(point)
        elif len(rest) < _MOST_HELD_OUT:
            rest.append(point)
    return Split(np.sort(np.array(chosen, np.int64)), np.sort(np.array(rest, np.int64)))


def errors_of(
    model: Reconstruction,  # poses and lenses to test
    whole: Reconstruction,  # the same photos in the same order, with all tracks
    points: np.ndarray,  # [B] int into the points of `whole`
) -> np.ndarray:
    """[B] mean Cauchy loss of each track once its point lies where it fits these cameras best: about the squared error
    [px^2] where that is small. Infinite where no place in front of the cameras is found."""
    seen = Observations.of(whole, points)
    return np.minimum(fitted(model, seen).loss, fitted(model, seen, whole.points[points]).loss)
