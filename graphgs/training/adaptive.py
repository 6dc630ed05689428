"""The classic densification strategy of 3DGS, with its later repairs as options."""

import math

import torch
from torch import Tensor

from graphgs.rendering import RenderOutput
from graphgs.training.config import TrainConfig
from graphgs.training.covariance import stretch
from graphgs.training.draws import generator_of
from graphgs.training.parameters import Parameters
from graphgs.training.schedule import Schedule

SPLIT_SHRINK = 1.6  # 3DGS: both halves of a split are that much smaller


class AdaptiveControl:
    """Adaptive density control (3DGS, Kerbl et al. 2023, section 5) under a hard limit: Gaussians whose projected
    centre is pulled strongly are cloned when small and split when large; faint and oversized ones are removed. When
    there is no room for all candidates, those with the strongest pull go first.

    `absgrad`: the pull is summed over pixels by size, so that pixels that pull opposite ways do not cancel (AbsGS, Ye
    et al. 2024), and has a threshold of its own. `revised_opacity`: both halves get the opacity that together gives
    the old one (Revising Densification, Rota Bulo et al. 2024, Eq. 5, who do so for clones alone)."""

    def __init__(
        self,
        config: TrainConfig,
        schedule: Schedule,
        *,
        extent: float,  # scene extent, world units
        seed: int,
        count: int,  # Gaussians at the start
        device: str,
        middle: Tensor | None = None,  # [3] world: with a far sphere around it, Gaussians may grow with the distance
    ):
        self._middle = middle
        self._config, self._schedule, self._extent, self._seed = config, schedule, extent, seed
        self._threshold = config.densify_absgrad if config.absgrad else config.densify_gradient
        self._start = count
        self._half_size: tuple[tuple[int, int], Tensor] | None = None  # of the last image, px; kept on the device
        self._pull = torch.zeros(count, device=device)  # sum of 2D gradient norms, NDC
        self._seen = torch.zeros(count, device=device)  # views that saw the Gaussian

    def wants_absgrad(self, step: int) -> bool:
        return self._config.absgrad and self._schedule.gathers_gradients(step)

    def before_backward(self, step: int, out: RenderOutput) -> None:
        if self._schedule.gathers_gradients(step):
            out.means2d.retain_grad()

    @torch.no_grad()
    def after_backward(self, step: int, out: RenderOutput) -> None:
        if not self._schedule.gathers_gradients(step):
            return
        height, width = out.colors.shape[1:3]
        gradient = (out.means2d.absgrad if self._config.absgrad else out.means2d.grad)[0]  # [N, 2], 0 where not visible
        if self._half_size is None or self._half_size[0] != (width, height):
            half = torch.tensor([width / 2, height / 2], device=gradient.device)
            self._half_size = (width, height), half
        self._pull += torch.linalg.vector_norm(gradient * self._half_size[1], dim=-1)
        self._seen += out.radii[0].amin(dim=-1) > 0

    @torch.no_grad()
    def after_step(self, step: int, parameters: Parameters) -> None:
        if self._schedule.densifies_after(step):
            self._round(step, parameters)
        if self._schedule.resets_opacities_after(step):
            parameters.cap_opacities(_logit(2.0 * self._config.prune_opacity))

    def limit_after(self, step: int) -> int:
        """Gaussians allowed after the round that follows `step`: a parabola from the initial number to `max_splats` at
        the end of the window (Taming 3DGS, Mallick et al. 2024), so that no early round uses up the budget."""
        left = 1.0 - self._schedule.densify_progress(step)
        return self._start + int((self._config.max_splats - self._start) * (1.0 - left**2))

    def keep_rows(self, kept: Tensor) -> None:
        self._pull, self._seen = self._pull[kept], self._seen[kept]

    def state(self) -> dict[str, Tensor]:
        return {"pull": self._pull, "seen": self._seen}

    def load_state(self, state: dict[str, Tensor]) -> None:
        self._pull = state["pull"].to(self._pull.device)
        self._seen = state["seen"].to(self._seen.device)

    def _round(self, step: int, parameters: Parameters) -> None:
        config = self._config
        sizes = parameters.values["log_scales"].detach().amax(dim=-1).exp() / self._lengths(parameters)
        pruned = parameters.values["logit_opacities"].detach() < _logit(config.prune_opacity)
        if self._schedule.prunes_large(step):
            pruned |= sizes > config.prune_scale
        if bool(pruned.all()):
            pruned.zero_()  # never leave an empty scene
        pull = self._pull / self._seen.clamp(min=1.0)
        grows = (pull > self._threshold) & ~pruned
        room = self.limit_after(step) - int((~pruned).sum())
        grows = _strongest(grows, pull, room)
        large = sizes > config.densify_scale
        if config.revised_opacity:
            parameters.values["logit_opacities"][grows] = _halved(parameters.values["logit_opacities"][grows])
        cloned, split = grows & ~large, grows & large
        added = _rows(parameters, cloned)
        halves = _halves(parameters, split, generator=generator_of(self._seed, step))
        kept = torch.nonzero(~pruned & ~split)[:, 0]
        parameters.rebuild(kept, {name: torch.cat([added[name], halves[name]]) for name in added})
        self._pull = torch.zeros(len(parameters), device=self._pull.device)
        self._seen = torch.zeros_like(self._pull)

    def _lengths(self, parameters: Parameters) -> float | Tensor:
        """What sizes are relative to: the scene's extent or, beyond it, the distance from its middle ([N])."""
        if self._middle is None:
            return self._extent
        distances = torch.linalg.vector_norm(parameters.values["means"].detach() - self._middle, dim=-1)
        return distances.clamp(min=self._extent)


def _strongest(candidates: Tensor, pull: Tensor, room: int) -> Tensor:
    """[N] bool: at most `room` of the candidates, strongest pull first, lower index first among equals."""
    if int(candidates.sum()) <= room:
        return candidates
    order = torch.argsort(torch.where(candidates, pull, -1.0), descending=True, stable=True)
    chosen = torch.zeros_like(candidates)
    chosen[order[: max(0, room)]] = True
    return chosen


def _rows(parameters: Parameters, mask: Tensor) -> dict[str, Tensor]:
    return {name: value.detach()[mask] for name, value in parameters.values.items()}


def _halves(parameters: Parameters, mask: Tensor, *, generator: torch.Generator) -> dict[str, Tensor]:
    """Two smaller Gaussians for each in `mask`, their centres drawn from it."""
    twice = {name: rows.repeat(2, *(1,) * (rows.dim() - 1)) for name, rows in _rows(parameters, mask).items()}
    scales = twice["log_scales"].exp()
    normal = torch.randn(scales.shape, generator=generator).to(scales.device)
    twice["means"] = twice["means"] + stretch(twice["quats"], scales, normal)
    twice["log_scales"] = twice["log_scales"] - math.log(SPLIT_SHRINK)
    return twice


def _halved(logits: Tensor) -> Tensor:
    """Opacities, as logits, of which two in a row let through what one of `logits` did: 1 - sqrt(1 - o)."""
    through = torch.sigmoid(-logits).sqrt()  # of one half
    # logit(1 - t) = log(1 - t) - log(t), where 1 - t = o / (1 + t) does not cancel for faint ones
    return torch.log(torch.sigmoid(logits) / (1.0 + through)) - torch.log(through)


def _logit(probability: float) -> float:
    return math.log(probability / (1.0 - probability))
