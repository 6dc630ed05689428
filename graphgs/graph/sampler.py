"""Which view each training step looks at: a function of the seed and the step, so that a resumed run goes on exactly
where it would have been, without saved state."""

from functools import lru_cache
from typing import Literal

import numpy as np

from graphgs.graph.camera_graph import CameraGraph, Measure

_GOLDEN = 0.6180339887498949  # fractional steps of it fill 0..1 most evenly

SamplerMode = Literal["graphgs", "paper", "affine", "uniform"]


class ViewSampler:
    """Training views, one per EXECUTED step. Never a test view.

    graphgs: in proportion to `sampling_probability`, with the least noise: per epoch of as many steps as there are
        training views, systematic draws (a comb laid over the summed probabilities) in a shuffled order. In one epoch a
        view appears floor or ceil of its expected number of times; the comb's offset moves by the golden ratio from
        epoch to epoch, so the fractions are made up for within a few.
    paper: as printed, draw uniformly and skip with probability 1 - max(minimum, P), until one is taken. Skipped draws
        are not steps; `acceptance` is the share of the paper's iterations that are executed.
    affine: the paper's way of drawing, with the probabilities of graphgs.
    uniform: the control: every view once per epoch, shuffled.
    """

    def __init__(
        self,
        graph: CameraGraph,
        seed: int,
        mode: SamplerMode = "graphgs",
        *,
        minimum: float = 0.5,
        measure: Measure = "betweenness",  # what makes a view important
    ):
        if mode not in ("graphgs", "paper", "affine", "uniform"):
            raise ValueError(f"mode: expected 'graphgs', 'paper', 'affine' or 'uniform', got {mode!r}")
        self._views = np.flatnonzero(~graph.is_test)
        if not len(self._views):
            raise ValueError("graph: expected at least one training view, got none")
        self._seed, self._mode = seed, mode
        if mode == "uniform":
            self._probability = np.ones(len(self._views))
        else:
            form = "paper" if mode == "paper" else "graphgs"
            self._probability = graph.sampling_probability(minimum, mode=form, measure=measure)[self._views]
        if not self._probability.any():
            raise ValueError(f"minimum: no view could ever be drawn with {minimum}")
        self._epoch = lru_cache(maxsize=2)(self._draw_epoch)

    @property
    def acceptance(self) -> float:
        """Share of uniform draws that the paper's rule would execute: the mean probability."""
        return float(self._probability.mean())

    def view(self, step: int) -> int:
        """Index of the view for executed step 0, 1, 2, ..."""
        if step < 0:
            raise ValueError(f"step: expected 0 or more, got {step}")
        if self._mode in ("paper", "affine"):
            return self._draw_and_skip(step)
        epoch, within = divmod(step, len(self._views))
        return int(self._epoch(epoch)[within])

    def _draw_epoch(self, epoch: int) -> np.ndarray:
        return self._views[draw_epoch(self._probability, self._seed, epoch)]

    def _draw_and_skip(self, step: int) -> int:
        rng = _generator(self._seed, step)
        while True:
            drawn = rng.integers(len(self._views))
            if rng.random() < self._probability[drawn]:
                return int(self._views[drawn])


def draw_epoch(
    probability: np.ndarray,  # [V] of each view, up to a factor
    seed: int,
    epoch: int,
) -> np.ndarray:
    """[V] int: the views of an epoch of V steps, each floor or ceil of its expected number of times."""
    count = len(probability)
    offset = (_generator(seed, 2**64 - 1).random() + epoch * _GOLDEN) % 1.0
    summed = np.cumsum(probability)
    teeth = (np.arange(count) + offset) * (summed[-1] / count)
    chosen = np.minimum(np.searchsorted(summed, teeth, side="right"), count - 1)
    return _generator(seed, epoch).permutation(chosen)


def _generator(seed: int, counter: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=np.array([seed & (2**64 - 1), counter], np.uint64)))
