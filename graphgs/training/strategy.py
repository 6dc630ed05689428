"""Who is added and who goes: what every densification strategy offers, and the choice of one."""

from typing import Protocol

from torch import Tensor

from graphgs.rendering import RenderOutput
from graphgs.training.adaptive import AdaptiveControl
from graphgs.training.config import TrainConfig
from graphgs.training.mcmc import MarkovChain
from graphgs.training.parameters import Parameters
from graphgs.training.schedule import Schedule


class Strategy(Protocol):
    """Hooks of the training loop. A strategy keeps len(parameters) within the run's `max_splats`, and what it does
    follows from its state, the seed and the step."""

    def wants_absgrad(self, step: int) -> bool:
        """Whether the render of this step must leave `means2d.absgrad`."""

    def before_backward(self, step: int, out: RenderOutput) -> None:
        """The view is rendered; ask for gradients of intermediate results here."""

    def after_backward(self, step: int, out: RenderOutput) -> None:
        """Gradients are there, the update is not."""

    def after_step(self, step: int, parameters: Parameters) -> None:
        """The update is done; rows may come and go."""

    def keep_rows(self, kept: Tensor) -> None:
        """Somebody else removed Gaussians: all but the rows `kept` [M] int64."""

    def state(self) -> dict[str, Tensor]:
        """What a resumed run needs."""

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Inverse of `state`."""


def make_strategy(
    config: TrainConfig,
    schedule: Schedule,
    *,
    extent: float,  # scene extent, world units
    seed: int,
    count: int,  # Gaussians at the start
    device: str,
    middle: Tensor | None = None,  # [3] world, of the cameras; given if a far sphere lies around the scene
) -> Strategy:
    """The strategy that `config.strategy` names."""
    if config.strategy == "mcmc":
        return MarkovChain(config, schedule, extent=extent, seed=seed, count=count, device=device)
    return AdaptiveControl(config, schedule, extent=extent, seed=seed, count=count, device=device, middle=middle)
