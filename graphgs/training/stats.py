"""What a training run did, for the report."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path


@dataclass
class TrainStats:
    """Grows while training runs; the curve has one entry per ten steps."""

    steps_executed: int = 0
    num_splats: int = 0
    seconds: float = 0.0  # [s] wall, all sessions of an interrupted run together
    recoveries: int = 0  # roll-backs after values that were not finite
    curve: list[dict] = field(default_factory=list)  # {"step", "loss" (mean of ten), "num_splats", "seconds"}

    def save(self, folder: Path) -> None:
        """Write losses.json."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "losses.json").write_text(json.dumps(asdict(self), indent=1))

    @staticmethod
    def load(folder: Path) -> "TrainStats":
        return TrainStats(**json.loads((folder / "losses.json").read_text()))
