"""Penalties on Gaussians that are opaquer or larger than the photos ask for."""

from torch import Tensor

from graphgs.training.config import TrainConfig

MCMC_WEIGHT = 0.01  # both weights of 3DGS as MCMC (Kheradmand et al. 2024)


class Regularisation:
    """Mean opacity and mean standard deviation (in scene extents), each times its weight: what no photo needs fades and
    shrinks (Kheradmand et al. 2024, section 3.3). `mcmc` relies on it, as only dead Gaussians move."""

    def __init__(self, config: TrainConfig, *, extent: float):
        usual = MCMC_WEIGHT if config.strategy == "mcmc" else 0.0
        self._opacity = usual if config.opacity_reg is None else config.opacity_reg
        self._scale = (usual if config.scale_reg is None else config.scale_reg) / extent

    def loss(
        self,
        scales: Tensor,  # [N, 3] world units
        opacities: Tensor,  # [N]
    ) -> Tensor | None:
        """The weighted sum; None when both weights are 0."""
        terms = [
            weight * values.mean()
            for weight, values in ((self._opacity, opacities), (self._scale, scales))
            if weight > 0.0
        ]
        return sum(terms) if terms else None
