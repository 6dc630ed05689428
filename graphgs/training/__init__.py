"""Training: from initial points and posed views to Gaussians."""

from graphgs.training.config import TrainConfig
from graphgs.training.run import train
from graphgs.training.stats import TrainStats

__all__ = ["TrainConfig", "TrainStats", "train"]
