"""What a run will cost, said before it starts. Unit costs were measured on two cores of a server CPU; another machine
differs by a factor of two either way, and the lines say so."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from graphgs.config import Config

# CPU seconds on one thread
DECODE_S = 0.2  # per photo
COARSE_S = 0.3  # per photo: features, some twenty pairs, mapping
FEATURES_S = 0.6  # per photo at 1600 px
PAIR_S = 0.05  # per pair at 4096 features
MAPPING_S = 0.2  # per photo
STEP_S = 0.08  # per training step at 270 x 480 px and some ten thousand Gaussians
STEP_PIXELS = 270 * 480
# Bytes
SPLAT_BYTES = 59 * 4 * 6  # parameters, gradients, two Adam moments, working copies
BASE_BYTES = 900 * 2**20


@dataclass(frozen=True)
class Forecast:
    """Rough figures, for planning."""

    pairs: int
    exhaustive: int
    structure_s: float
    training_s: float
    memory_bytes: float
    threads: int

    def lines(self) -> Iterator[str]:
        yield f"forecast for {self.threads} CPU threads (rough; another machine may differ twofold):"
        yield f"  pairs     about {self.pairs} of {self.exhaustive}"
        yield f"  poses     about {_duration(self.structure_s)}"
        yield f"  training  about {_duration(self.training_s)} on the CPU"
        yield f"  memory    about {self.memory_bytes / 2**30:.1f} GiB"


def forecast(
    config: Config,
    sizes: np.ndarray,  # [N, 2] px of the photos
    *,
    threads: int,
) -> Forecast:
    n = len(sizes)
    exhaustive = n * (n - 1) // 2
    pairs = exhaustive if config.pairing.pairs == "exhaustive" else min(exhaustive, round(5 * n))
    structure = n * (DECODE_S + COARSE_S + FEATURES_S + MAPPING_S) + pairs * PAIR_S
    longest = sizes.max(axis=1)
    limit = config.structure.max_side or config.sources.decode_max_side
    scale = np.minimum(1.0, limit / longest)
    pixels = float(np.mean(sizes.prod(axis=1) * scale**2))
    training = config.training.steps * STEP_S * pixels / STEP_PIXELS
    memory = BASE_BYTES + config.training.max_splats * SPLAT_BYTES
    return Forecast(pairs, exhaustive, structure / threads, 2 * training / threads, memory, threads)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
