"""Densification as sampling: 3D Gaussian Splatting as Markov Chain Monte Carlo (Kheradmand et al. 2024)."""

import math

import torch
from torch import Tensor

from graphgs.rendering import RenderOutput
from graphgs.training.config import TrainConfig
from graphgs.training.covariance import apply_covariance
from graphgs.training.draws import draw_rows, generator_of
from graphgs.training.parameters import Parameters
from graphgs.training.schedule import Schedule

MOST_SHARES = 51  # the paper's limit on how many Gaussians one is divided into at once
NOISE_SHARPNESS = 100.0  # how suddenly noise sets in as opacity falls ...
NOISE_OPACITY = 0.005  # ... below this


class MarkovChain:
    """Gaussians as samples: those that have become transparent move to where opaque ones are, whose place they share
    without changing the picture; a round may add a few per cent, up to `max_splats`; and noise along their own
    covariance keeps faint ones exploring. Nothing is cloned by gradients, split, pruned or reset.

    The penalties on opacity and size that make Gaussians die are part of the loss (`opacity_reg`, `scale_reg`)."""

    def __init__(
        self,
        config: TrainConfig,
        schedule: Schedule,
        *,
        extent: float,  # scene extent, world units
        seed: int,
        count: int,  # Gaussians at the start
        device: str,
    ):
        self._config, self._schedule, self._extent, self._seed = config, schedule, extent, seed

    def wants_absgrad(self, step: int) -> bool:
        return False

    def before_backward(self, step: int, out: RenderOutput) -> None:
        pass

    def after_backward(self, step: int, out: RenderOutput) -> None:
        pass

    @torch.no_grad()
    def after_step(self, step: int, parameters: Parameters) -> None:
        generator = generator_of(self._seed, step)
        if self._schedule.relocates_after(step):
            self._relocate(parameters, generator)
            self._grow(parameters, generator)
        self._disturb(step, parameters, generator)

    def keep_rows(self, kept: Tensor) -> None:
        pass

    def state(self) -> dict[str, Tensor]:
        return {}

    def load_state(self, state: dict[str, Tensor]) -> None:
        pass

    def _relocate(self, parameters: Parameters, generator: torch.Generator) -> None:
        opacities = torch.sigmoid(parameters.values["logit_opacities"].detach())
        dead = opacities <= self._config.prune_opacity
        rows = torch.nonzero(dead)[:, 0]
        if not len(rows) or len(rows) == len(opacities):
            return
        sources = draw_rows(torch.where(dead, 0.0, opacities), len(rows), generator)
        parameters.overwrite(rows, self._shared(parameters, sources))

    def _grow(self, parameters: Parameters, generator: torch.Generator) -> None:
        count = len(parameters)
        more = min(self._config.max_splats, int((1.0 + self._config.mcmc_growth) * count)) - count
        if more <= 0:
            return
        sources = draw_rows(torch.sigmoid(parameters.values["logit_opacities"].detach()), more, generator)
        everyone = torch.arange(count, device=sources.device)
        parameters.rebuild(everyone, self._shared(parameters, sources))

    def _shared(self, parameters: Parameters, sources: Tensor) -> dict[str, Tensor]:
        """[S, ...] per group: the newcomers at `sources` [S], after the sources themselves have made room for them."""
        hosts, index, counts = torch.unique(sources, return_inverse=True, return_counts=True)
        values = {name: value.detach()[hosts] for name, value in parameters.values.items()}
        opacities, shrink = share(torch.sigmoid(values["logit_opacities"]), counts + 1)
        # a share below the limit would be dead at once
        values["logit_opacities"] = torch.logit(opacities.clamp(self._config.prune_opacity, 1.0 - 1e-6))
        values["log_scales"] = values["log_scales"] + torch.log(shrink)[:, None]
        parameters.overwrite(hosts, values)
        return {name: rows[index] for name, rows in values.items()}

    def _disturb(self, step: int, parameters: Parameters, generator: torch.Generator) -> None:
        """The noise of stochastic gradient Langevin dynamics (Eq. 9): along the covariance, only for faint Gaussians.

        The paper's factor belongs to scenes of extent 1; in extents the noise means the same at any scale."""
        values = {name: value.detach() for name, value in parameters.values.items()}
        opacities = torch.sigmoid(values["logit_opacities"])
        rate = self._schedule.rates(step, extent=1.0)["means"] * self._config.mcmc_noise
        faint = torch.sigmoid(NOISE_SHARPNESS * (NOISE_OPACITY - opacities))
        normal = torch.randn(values["means"].shape, generator=generator).to(faint.device)
        noise = apply_covariance(values["quats"], values["log_scales"].exp(), normal)
        values["means"] += (rate / self._extent) * faint[:, None] * noise


def share(
    opacities: Tensor,  # [N] in 0..1
    counts: Tensor,  # [N] int, Gaussians in place of one, the one included
) -> tuple[Tensor, Tensor]:
    """([N] opacities, [N] factors on the scales) with which `counts` equal Gaussians look like the one (Eq. 9 of the
    paper's appendix; its double sum of binomials is the single one below by the hockey-stick identity)."""
    counts = counts.clamp(max=MOST_SHARES)
    old = opacities.double()
    new = 1.0 - (1.0 - old) ** (1.0 / counts.double())
    k = torch.arange(1, MOST_SHARES + 1, device=new.device, dtype=torch.float64)
    terms = _binomials(new.device)[counts] * new[:, None] ** k * (-1.0) ** (k + 1) / torch.sqrt(k)
    return new.to(opacities.dtype), (old / terms.sum(dim=1)).to(opacities.dtype)


def _binomials(device: torch.device) -> Tensor:
    """[MOST_SHARES + 1, MOST_SHARES] n over k, for k from 1."""
    rows = [[math.comb(n, k) for k in range(1, MOST_SHARES + 1)] for n in range(MOST_SHARES + 1)]
    return torch.tensor(rows, dtype=torch.float64, device=device)
