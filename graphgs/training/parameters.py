"""The trainable rows: one per Gaussian, each with its Adam moments, which stay together through densification."""

import torch
from torch import Tensor

from graphgs.rendering.splats import Splats

GROUPS = ("means", "quats", "log_scales", "logit_opacities", "sh_coeffs")
BETAS = (0.9, 0.999)  # Adam, Kingma & Ba 2015
EPS = 1e-15  # 3DGS: gradients of a mean over pixels are tiny


class Parameters:
    """Values [N, ...] and first and second Adam moments of every group in GROUPS."""

    def __init__(self, values: dict[str, Tensor]):
        self.values = {name: values[name].detach().clone().requires_grad_() for name in GROUPS}
        self.moments1 = {name: torch.zeros_like(value, requires_grad=False) for name, value in self.values.items()}
        self.moments2 = {name: torch.zeros_like(value, requires_grad=False) for name, value in self.values.items()}

    @staticmethod
    def from_splats(splats: Splats) -> "Parameters":
        return Parameters({name: getattr(splats, name) for name in GROUPS})

    def __len__(self) -> int:
        return self.values["means"].shape[0]

    def splats(self, sh_degree: int) -> Splats:
        """A snapshot, detached."""
        return Splats(**{name: value.detach().clone() for name, value in self.values.items()}, sh_degree=sh_degree)

    @torch.no_grad()
    def step(
        self,
        step: int,
        rates: dict[str, float],
        *,
        rows: Tensor | None = None,  # [M] int64: what is updated, values and moments; None is all
    ) -> None:
        """One Adam update from the gathered gradients, which are dropped. A group without gradient stays as it is.

        The harmonics have two rates, `sh_dc` for the constant one and `sh_rest`, and one tensor: to join two would cost
        a copy forward and two backward, an eighth of a step. Adam's update is proportional to the rate, so the constant
        one's is stretched afterwards."""
        count = torch.full((), step + 1.0, device=self.values["means"].device)  # made there, not sent
        for name, value in self.values.items():
            if value.grad is None:
                continue
            if name != "sh_coeffs":
                self._update(name, count, rates[name], rows)
                continue
            constant = value[:, 0].clone()
            self._update(name, count, rates["sh_rest"], rows)
            value[:, 0] = torch.lerp(constant, value[:, 0], rates["sh_dc"] / rates["sh_rest"])

    def _update(self, name: str, count: Tensor, rate: float, rows: Tensor | None) -> None:
        """torch's fused kernel: 0.7 ms for 13k Gaussians on one thread, a third of what a Warp kernel took. Called as
        `torch.optim.adam` calls it, without its preparations, which take longer on a GPU than the update."""
        value, moments = self.values[name], (self.moments1[name], self.moments2[name])
        state = (value.detach(), value.grad, *moments)
        if rows is not None:
            state = tuple(tensor[rows] for tensor in state)
        torch._fused_adam_(
            *([tensor] for tensor in state),
            [],
            [count],
            amsgrad=False,
            beta1=BETAS[0],
            beta2=BETAS[1],
            lr=rate,
            weight_decay=0.0,
            eps=EPS,
            maximize=False,
        )
        if rows is not None:
            for whole, part in zip((value, *moments), (state[0], *state[2:]), strict=True):
                whole[rows] = part
        value.grad = None

    def clear_gradients(self) -> None:
        for value in self.values.values():
            value.grad = None

    @torch.no_grad()
    def rebuild(
        self,
        kept: Tensor,  # [M] int64, rows that stay, with their moments
        added: dict[str, Tensor],  # [A, ...] per group: new rows, moments zero
    ) -> None:
        """Rows `kept`, then the new ones."""
        for name in GROUPS:
            new = added[name]
            value = torch.cat([self.values[name].detach()[kept], new])
            self.values[name] = value.requires_grad_()
            for moments in (self.moments1, self.moments2):
                moments[name] = torch.cat([moments[name][kept], torch.zeros_like(new)])

    def keep(self, kept: Tensor) -> None:
        """Rows `kept` [M] int64 alone, with their moments."""
        self.rebuild(kept, {name: value.detach()[:0] for name, value in self.values.items()})

    @torch.no_grad()
    def overwrite(
        self,
        rows: Tensor,  # [M] int64, distinct
        values: dict[str, Tensor],  # [M, ...] per group
    ) -> None:
        """Put other Gaussians into these rows and forget their moments."""
        for name in GROUPS:
            self.values[name][rows] = values[name]
            self.moments1[name][rows] = 0.0
            self.moments2[name][rows] = 0.0

    @torch.no_grad()
    def cap_opacities(self, logit: float) -> None:
        """Lower every opacity to at most `logit` and forget its moments."""
        self.values["logit_opacities"].clamp_(max=logit)
        self.moments1["logit_opacities"].zero_()
        self.moments2["logit_opacities"].zero_()

    @property
    def is_finite(self) -> bool:
        # a sum is finite only if no term is NaN or infinite; far cheaper than a mask, and overflow needs 1e38
        return all(bool(torch.isfinite(value.detach().sum())) for value in self.values.values())

    def state(self) -> dict[str, Tensor]:
        """Everything, by flat names, for a checkpoint."""
        parts = {"values": self.values, "moments1": self.moments1, "moments2": self.moments2}
        return {f"{part}.{name}": tensors[name].detach() for part, tensors in parts.items() for name in GROUPS}

    @staticmethod
    def from_state(state: dict[str, Tensor], device: str) -> "Parameters":
        parameters = Parameters({name: state[f"values.{name}"].to(device) for name in GROUPS})
        for name in GROUPS:
            parameters.moments1[name] = state[f"moments1.{name}"].to(device)
            parameters.moments2[name] = state[f"moments2.{name}"].to(device)
        return parameters
