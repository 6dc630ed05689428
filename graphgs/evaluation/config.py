"""Settings of the evaluation stage."""

from dataclasses import dataclass


@dataclass(frozen=True)
class EvaluationConfig:
    """How test views are judged. The measures have no settings: figures of different runs stay comparable."""

    error_max: float = 0.25
    """Absolute colour error (white is 1) at the bright end of the error pictures. Ours: a quarter of the range."""

    def __post_init__(self):
        if not self.error_max > 0:
            raise ValueError(f"error_max: expected more than 0, got {self.error_max}")
