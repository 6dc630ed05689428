"""Every photo's own exposure and white balance, so that the scene need not explain them."""

import numpy as np
import torch
from torch import Tensor

from graphgs.training.config import TrainConfig
from graphgs.training.view_rows import ViewRows


class Exposure:
    """An affine colour transform per training view, applied to its render before it is compared with its photo
    (Hierarchical 3DGS, Kerbl et al. 2024): colour' = A colour + b, the identity at the start.

    Scaling every Gaussian and undoing it in every view changes no comparison. That gauge is fixed here: the mean of
    the transforms over the training views stays the identity, so a held-out view, which has no transform, is rendered
    at the mean exposure of the training photos."""

    def __init__(
        self,
        config: TrainConfig,
        is_test: np.ndarray,  # [N] bool
        *,
        device: str,
    ):
        self._config = config
        self._row_of_view = np.where(is_test, -1, np.cumsum(~is_test) - 1)
        self._rows = ViewRows(int((~is_test).sum()), 12, device=device)  # [A - 1 | b], row by row
        self._identity = torch.eye(3, 4, device=device)
        self._leaf: Tensor | None = None  # [12] of the view that is being compared

    def apply(
        self,
        view: int,
        colors: Tensor,  # [1, H, W, 3]
    ) -> Tensor:
        """The render as the camera of `view` would have exposed it; gradients reach the colours and the transform."""
        self._leaf = self._rows.values[self._row(view)].clone().requires_grad_()
        return _transformed(colors, self._leaf.reshape(3, 4) + self._identity)

    def applied_fixed(self, view: int, colors: Tensor) -> Tensor:
        """The same without gradient to the transform."""
        return _transformed(colors, self.transform(view))

    def penalty(self) -> Tensor:
        """Of the last transform applied: its squared distance from the identity, weighted."""
        return self._config.exposure_weight * (self._leaf**2).sum()

    @torch.no_grad()
    def step(self, view: int, step: int, caution: float) -> None:
        """One update of the view's transform from the gathered gradient, then back to the gauge."""
        progress = step / max(1, self._config.steps - 1)
        rate = caution * self._config.exposure_rate ** (1 - progress) * self._config.exposure_rate_final**progress
        self._rows.values[self._row(view)] += self._rows.stride(self._row(view), self._leaf.grad, rate)
        self._rows.values -= self._rows.values.mean(dim=0)
        self._leaf = None

    def transform(self, view: int) -> Tensor:
        """[3, 4], A and b; the identity for a held-out view."""
        row = int(self._row_of_view[view])
        return self._identity if row < 0 else self._rows.values[row].reshape(3, 4) + self._identity

    def transforms(self) -> np.ndarray:
        """[N, 3, 4] of all views."""
        return np.stack([self.transform(view).cpu().numpy() for view in range(len(self._row_of_view))])

    @property
    def is_finite(self) -> bool:
        return self._rows.is_finite

    def state(self) -> dict[str, Tensor]:
        return self._rows.state()

    def load_state(self, state: dict[str, Tensor]) -> None:
        self._rows.load_state(state)

    def _row(self, view: int) -> int:
        row = int(self._row_of_view[view])
        if row < 0:
            raise ValueError(f"exposure: view {view} is held out, so it has no transform to fit")
        return row


def _transformed(colors: Tensor, transform: Tensor) -> Tensor:
    return colors @ transform[:, :3].T + transform[:, 3]
