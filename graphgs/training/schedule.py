"""What changes over a run, as pure functions of the executed step (0 is the first)."""

from graphgs.training.config import TrainConfig

LEAST_INTERVAL = 10  # steps between two rounds: the gradients of fewer views say little
FLOATER_CHECKS = (0.3, 0.5, 0.7)  # of the run: what they leave has time to take over
REFERENCE_STEPS = 30_000  # the length that 3DGS's rates are tuned for


class Schedule:
    """Rates, degrees and windows of one run. Holds no state, so a resumed run sees the same schedule."""

    def __init__(self, config: TrainConfig):
        self._config = config
        steps = config.steps
        self._sh_interval = max(1, min(config.sh_degree_interval, round(config.sh_degree_fraction * steps)))
        self.densify_from = min(config.densify_from_step, round(config.densify_from_fraction * steps))
        self.densify_interval = min(
            config.densify_interval, max(LEAST_INTERVAL, round(config.densify_interval_fraction * steps))
        )
        self.densify_until = round(config.densify_until_fraction * steps)
        self._relocate_until = round(config.mcmc_until_fraction * steps)
        self.consistency_from = round(config.consistency_from_fraction * steps)
        self._warm_up_until = round(config.warm_up_fraction * steps)
        self._robust_from = round(config.robust_from_fraction * steps)
        self._floater_checks = {round(share * steps) for share in FLOATER_CHECKS}

    def rates(self, step: int, *, extent: float) -> dict[str, float]:
        """Learning rate of every group of parameters; `extent` is the scene's, in world units.

        Centres move exponentially less from the first to the last executed step. A short run takes longer strides
        (opacities do not: they settle within a hundred steps at any length)."""
        config = self._config
        shortness = max(1.0, REFERENCE_STEPS / config.steps)
        stride, means_stride = shortness**config.short_run_exponent, shortness**config.short_run_means_exponent
        progress = step / max(1, config.steps - 1)
        means_rate = config.means_rate ** (1.0 - progress) * config.means_rate_final**progress
        return {
            "means": means_stride * extent * means_rate,
            "quats": stride * config.quats_rate,
            "log_scales": stride * config.log_scales_rate,
            "logit_opacities": config.logit_opacities_rate,
            "sh_dc": stride * config.sh_dc_rate,
            "sh_rest": stride * config.sh_rest_rate,
        }

    def sh_degree(self, step: int) -> int:
        """Active degree of the spherical harmonics."""
        return min(self._config.sh_degree, step // self._sh_interval)

    def reduction(self, step: int) -> int:
        """How many times smaller the photo of this step is: 4, 2, and 1 once the warm-up is over."""
        if step >= self._warm_up_until:
            return 1
        return 4 if step < self._warm_up_until // 2 else 2

    def removes_floaters_after(self, step: int) -> bool:
        return step + 1 in self._floater_checks

    @property
    def settled_from(self) -> int:
        """First step from which only rates and the depths' weight change: losses before and after it do not compare."""
        rounds = self._relocate_until if self._config.strategy == "mcmc" else self.densify_until
        parts = [self._warm_up_until, rounds, self._config.sh_degree * self._sh_interval]
        if self._config.consistency != "none" and self._config.lambda_consistency > 0.0:
            parts.append(self.consistency_from)
        if self._config.robust_share > 0.0:
            parts.append(self._robust_from)
        if self._config.prune_near or self._config.prune_unconfirmed:
            parts.append(max(self._floater_checks))
        return max(parts)

    def gathers_gradients(self, step: int) -> bool:
        """Whether the step counts towards the next densification round."""
        return step < self.densify_until

    def densifies_after(self, step: int) -> bool:
        """Whether a round follows this step: a full interval has been seen and the window is open."""
        done = step + 1
        return self.densify_from <= done < self.densify_until and done % self.densify_interval == 0

    def relocates_after(self, step: int) -> bool:
        """Whether dead Gaussians move and new ones appear after this step (MCMC), in the same rounds but for longer."""
        done = step + 1
        return self.densify_from <= done < self._relocate_until and done % self.densify_interval == 0

    def densify_progress(self, step: int) -> float:
        """Share of the densification rounds that are over once the one after this step is; 1 after the last."""
        interval = self.densify_interval
        first = -(-self.densify_from // interval)  # the rounds' multiples of the interval
        last = (self.densify_until - 1) // interval
        return min(1.0, max(0.0, ((step + 1) // interval - first + 1) / max(1, last - first + 1)))

    def resets_opacities_after(self, step: int) -> bool:
        """Resets happen while Gaussians are added, and need an interval to recover from: short runs have none."""
        done, interval = step + 1, self._config.opacity_reset_interval
        return done % interval == 0 and done < self.densify_until and self._config.steps - done >= interval

    def prunes_large(self, step: int) -> bool:
        """3DGS removes oversized Gaussians once opacities have been reset."""
        return step + 1 > self._config.opacity_reset_interval

    def leaves_out_misfits(self, step: int) -> bool:
        return self._config.robust_share > 0.0 and step >= self._robust_from

    def has_consistency(self, step: int) -> bool:
        config = self._config
        return (
            config.consistency != "none"
            and config.lambda_consistency > 0.0
            and step >= self.consistency_from
            and self.reduction(step) == 1
            and step % config.consistency_interval == 0
        )
