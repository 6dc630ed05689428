"""Which view each training step looks at: a function of the seed and the step, so that a resumed run goes on exactly
where it would have been, without saved state."""

from functools import lru_cache
from typing import Literal

import numpy as np

from graphgs.graph.camera_graph import CameraGraph

_GOLDEN = 0.6180339887498949  # fractional steps of it fill 0..1 most evenly


class ViewSampler:
    """Training views, one per EXECUTED step. Never a test view.

    graphgs: in proportion to `sampling_probability`, with the least noise: per epoch of as many steps as there are
        training views, systematic draws (a comb laid over the summed probabilities) in a shuffled order. In one epoch a
        view appears floor or ceil of its expected number of times; the comb's offset moves by the golden ratio from
        epoch to epoch, so the fractions are made up for within a few.
    paper: as printed, draw uniformly and skip with probability 1 - max(minimum, P), until one is taken. Skipped draws
        are not steps; `acceptance` is the share of the paper's iterations that are executed.
    uniform: the control: every view once per epoch, shuffled.
    """

    def __init__(
        self,
        graph: CameraGraph,
        seed: int,
        mode: Literal["graphgs", "paper", "uniform"] = "graphgs",
        *,
        minimum: float = 0.5,
    ):
        if mode not in ("graphgs", "paper", "uniform"):
            raise ValueError(f"mode: expected 'graphgs', 'paper' or 'uniform', got {mode!r}")
        self._views = np.flatnonzero(~graph.is_test)
        if not len(self._views):
            raise ValueError("graph: expected at least one training view, got none")
        self._seed, self._mode = seed & (2**64 - 1), mode
        if mode == "uniform":
            self._probability = np.ones(len(self._views))
        else:
            self._probability = graph.sampling_probability(minimum, mode=mode)[self._views]
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
        if self._mode == "paper":
            return self._draw_and_skip(step)
        epoch, within = divmod(step, len(self._views))
        return int(self._epoch(epoch)[within])

    def _draw_epoch(self, epoch: int) -> np.ndarray:
        count = len(self._views)
        offset = (self._generator(2**64 - 1).random() + epoch * _GOLDEN) % 1.0
        summed = np.cumsum(self._probability)
        teeth = (np.arange(count) + offset) * (summed[-1] / count)
        chosen = np.minimum(np.searchsorted(summed, teeth, side="right"), count - 1)
        return self._views[self._generator(epoch).permutation(chosen)]

    def _draw_and_skip(self, step: int) -> int:
        rng = self._generator(step)
        while True:
            drawn = rng.integers(len(self._views))
            if rng.random() < self._probability[drawn]:
                return int(self._views[drawn])

    def _generator(self, counter: int) -> np.random.Generator:
        return np.random.Generator(np.random.Philox(key=np.array([self._seed, counter], np.uint64)))
