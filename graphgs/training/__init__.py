"""Training: from initial points and posed views to Gaussians."""

from graphgs.training.config import TrainConfig
from graphgs.training.stats import TrainStats

__all__ = ["TrainConfig", "TrainStats", "train"]


def __getattr__(name: str):
    """Load torch and the kernels only when training is asked for: settings alone stay light."""
    if name == "train":
        from graphgs.training.run import train

        return train
    raise AttributeError(f"module 'graphgs.training' has no attribute {name!r}")
