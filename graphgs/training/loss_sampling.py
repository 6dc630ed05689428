"""Views drawn in proportion to how badly they are explained: ours, beside the camera graph's importance."""

import numpy as np
import torch
from torch import Tensor

from graphgs.graph import CameraGraph
from graphgs.graph.sampler import draw_epoch

LEAST = 0.5  # of the largest probability, as in the graph's form: no view is forgotten


class LossSampler:
    """Epochs of as many steps as there are training views, drawn as `ViewSampler` draws, with P = 0.5 + 0.5 l / max l,
    l the last photometric loss of a view. The next photo is decoded ahead, so an epoch is settled when the one before
    it begins: with the losses of two epochs ago. The first two are uniform."""

    def __init__(self, graph: CameraGraph, *, seed: int, device: str):
        self._views = np.flatnonzero(~graph.is_test)
        if not len(self._views):
            raise ValueError("graph: expected at least one training view, got none")
        self._row_of_node = np.cumsum(~graph.is_test) - 1
        self._seed = seed
        self._losses = torch.full((len(self._views),), float("nan"), device=device)  # NaN: not seen yet
        even = np.ones(len(self._views))
        # [V] rows of the views by epoch, of those epochs that may still be asked for
        self._orders = {epoch: draw_epoch(even, seed, epoch) for epoch in (0, 1)}

    def view(self, step: int) -> int:
        """Index of the graph's node for a step of the running epoch, the one before, or the next."""
        epoch, within = divmod(step, len(self._views))
        return int(self._views[self._orders[epoch][within]])

    def note(self, node: int, step: int, loss: Tensor) -> None:
        """The photometric loss of an executed step, detached."""
        self._losses[self._row_of_node[node]] = loss
        epoch, within = divmod(step, len(self._views))
        if within == len(self._views) - 1:
            losses = self._losses.cpu().numpy().astype(np.float64)
            largest = np.nanmax(losses)
            share = np.nan_to_num(losses / largest, nan=1.0) if largest > 0.0 else np.ones_like(losses)
            self._orders[epoch + 2] = draw_epoch(LEAST + (1.0 - LEAST) * share, self._seed, epoch + 2)
            self._orders.pop(epoch - 1, None)

    @property
    def is_finite(self) -> bool:
        return True  # a loss that is not finite is noticed as such

    def state(self) -> dict[str, Tensor]:
        epochs = sorted(self._orders)
        return {
            "losses": self._losses,
            "epochs": torch.tensor(epochs),
            "orders": torch.from_numpy(np.stack([self._orders[epoch] for epoch in epochs])),
        }

    def load_state(self, state: dict[str, Tensor]) -> None:
        self._losses = state["losses"].to(self._losses.device)
        self._orders = dict(zip(state["epochs"].tolist(), state["orders"].cpu().numpy(), strict=True))
