"""An optimiser for a few strongly coupled values per view, such as the six of a pose."""

import numpy as np
import torch
from torch import Tensor

from graphgs.training.parameters import BETAS

MEMORY = 0.99  # of the second moments: all views feed them, so they settle within a few hundred updates
LEAST_VARIANCE = 1e-6  # of the sum of all; a direction that no photo says anything about does not run away
EPS = 1e-30  # gradients of exactly zero move nothing


class WhitenedSteps:
    """Adam (Kingma & Ba 2015) with the whole matrix of second moments, one for all views, in place of its diagonal.

    Turning a camera and shifting it sideways move the image almost alike: along that valley the diagonal form hardly
    moves. Whitened, all directions are equally long. Values are float64 on the CPU."""

    def __init__(self, count: int, width: int):
        self._moments = np.zeros((count, width))
        self._updates = np.zeros(count)
        self._covariance = np.zeros((width, width))

    def stride(
        self,
        row: int,  # the view
        gradient: np.ndarray,  # [D] finite, in units that make the values comparable
    ) -> np.ndarray:  # [D] in the same units, about 1 long in every direction while gradients agree
        beta = BETAS[0]
        self._updates[row] += 1.0
        self._moments[row] = beta * self._moments[row] + (1.0 - beta) * gradient
        self._covariance = MEMORY * self._covariance + (1.0 - MEMORY) * np.outer(gradient, gradient)
        mean = self._moments[row] / (1.0 - beta ** self._updates[row])
        covariance = self._covariance / (1.0 - MEMORY ** self._updates.sum())
        variances, axes = np.linalg.eigh(covariance)
        variances = np.maximum(variances, LEAST_VARIANCE * np.trace(covariance)) + EPS
        return -axes @ ((axes.T @ mean) / np.sqrt(variances))

    def state(self) -> dict[str, Tensor]:
        return {name: torch.from_numpy(getattr(self, f"_{name}").copy()) for name in _STATE}

    def load_state(self, state: dict[str, Tensor]) -> None:
        for name in _STATE:
            setattr(self, f"_{name}", state[name].numpy().copy())


_STATE = ("moments", "updates", "covariance")
