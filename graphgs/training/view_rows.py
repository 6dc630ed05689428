"""Values of which every training view has its own row, and their optimiser."""

import torch
from torch import Tensor

from graphgs.training.parameters import BETAS, EPS


class ViewRows:
    """Values [V, D] with Adam moments. Only the row of the view that was rendered moves, and each row counts its own
    updates: with one count and dense moments, momentum would go on moving views that no photo was compared with."""

    def __init__(self, count: int, width: int, *, device: str):
        self.values = torch.zeros(count, width, device=device)
        self._moments1 = torch.zeros_like(self.values)
        self._moments2 = torch.zeros_like(self.values)
        self._updates = torch.zeros(count, 1, device=device)

    @torch.no_grad()
    def stride(
        self,
        row: int,
        gradient: Tensor,  # [D]
        rates: float | Tensor,  # [D] or one for all
    ) -> Tensor:  # [D]
        """What Adam (Kingma & Ba 2015) would add to the row; advances the row's moments, not its values."""
        beta1, beta2 = BETAS
        self._updates[row] += 1.0
        first = self._moments1[row].mul_(beta1).add_(gradient, alpha=1.0 - beta1)
        second = self._moments2[row].mul_(beta2).addcmul_(gradient, gradient, value=1.0 - beta2)
        updates = self._updates[row]
        return -rates * (first / (1.0 - beta1**updates)) / ((second / (1.0 - beta2**updates)).sqrt() + EPS)

    @property
    def is_finite(self) -> bool:
        return bool(torch.isfinite(self.values.sum()))

    def state(self) -> dict[str, Tensor]:
        return {name: getattr(self, attribute) for name, attribute in _STATE.items()}

    def load_state(self, state: dict[str, Tensor]) -> None:
        for name, attribute in _STATE.items():
            setattr(self, attribute, state[name].to(self.values.device))


_STATE = {"values": "values", "moments1": "_moments1", "moments2": "_moments2", "updates": "_updates"}
