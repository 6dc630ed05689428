"""Whether training still gets anywhere."""

import math

from graphgs.training.config import TrainConfig
from graphgs.training.schedule import Schedule


def has_settled(
    config: TrainConfig,
    schedule: Schedule,
    curve: list[dict],  # one entry per ten steps: {"step": executed so far, "loss": their mean, ...}
) -> bool:
    """Whether the mean loss of the last `plateau_steps` is less than `plateau_gain` (relative) below that of as many
    before. Only steps that had the whole loss at full size and a settled number of Gaussians are compared."""
    window = config.plateau_steps
    if window == 0 or not curve:
        return False
    now = curve[-1]["step"]
    if now - 2 * window < schedule.settled_from:
        return False
    late = [entry["loss"] for entry in curve if entry["step"] > now - window]
    early = [entry["loss"] for entry in curve if now - 2 * window < entry["step"] <= now - window]
    if not (late and early):
        return False
    return math.fsum(late) / len(late) > (1.0 - config.plateau_gain) * math.fsum(early) / len(early)
