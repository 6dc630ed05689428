"""What a run will cost, said before it starts. Unit costs are means over four real photo sets (30 to 51 photos) on two
cores of a server CPU; single sets differed from them by up to a factor of two, and another machine differs too."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from graphgs.config import Config
from graphgs.points.dense import MOST_PIXELS

# Seconds on one thread
DECODE_S = 0.15  # per photo: .05 (0.5 megapixels) to .23 (2 megapixels)
COARSE_S = 0.6  # per photo: .5 to .85
FEATURES_S = 1.2  # per photo at 1600 px and 4096 features
PAIR_S = 0.05  # per pair
MAPPING_S = 0.25  # per photo: .06 to .4
DENSE_S, DENSE_PIXELS = 0.3, 256 * 144  # per photo of this size swept with 4 partners: .2 to .4
DENSE_BYTES = 11  # per pixel of all swept photos
PAIRS_PER_PHOTO = 4.5  # 3.6 to 4.9
# A training step at 270 x 480 px, seconds on one thread, fitted to: 13,600 Gaussians .056; runs that end with 20,000
# .036 to .055; forward and backward alone, 10,000 .035 and 50,000 .088 (on two threads .033 and .055)
PIXEL_S = 0.025 / (270 * 480)
SPLAT_S = 1.8e-6
# On an H100, the only card measured: 13,600 Gaussians .0048; forward and backward of 1,000,000 take .003 more
CARD_S, CARD_SPLAT_S = 0.0045, 5e-9
MEAN_SHARE = 0.8  # of max_splats, over a run
# Peak memory: 1.1 GiB for whole runs with 30,000 Gaussians; 2.2 kB more for each Gaussian from 10,000 to 300,000
BASE_BYTES = 1.0 * 2**30
SPLAT_BYTES = 2_300


@dataclass(frozen=True)
class Forecast:
    """Rough figures, for planning."""

    pairs: int
    exhaustive: int
    structure_s: float  # wall
    training_s: float  # wall, on the CPU, if training uses all of max_splats
    card_s: float  # wall, on a card
    memory_bytes: float  # if training uses all of max_splats
    threads: int

    def lines(self) -> Iterator[str]:
        yield f"forecast for {self.threads} CPU threads (rough: a factor of two either way):"
        yield f"  pairs     about {self.pairs} of {self.exhaustive}"
        yield f"  poses     about {_duration(self.structure_s)}"
        cpu, card = _duration(self.training_s), _duration(self.card_s)
        yield f"  training  up to {cpu} on the CPU, {card} on a card like an H100"
        yield f"  memory    up to {self.memory_bytes / 2**30:.1f} GiB"

    def line(self, device: str) -> str:
        """In one line, for the device that will train."""
        training = self.training_s if device == "cpu" else self.card_s
        return (
            f"forecast, within a factor of two: {self.pairs} pairs, poses {_duration(self.structure_s)}, "
            f"training up to {_duration(training)}, memory up to {self.memory_bytes / 2**30:.1f} GiB"
        )


def forecast(
    config: Config,
    sizes: np.ndarray,  # [N, 2] px of the photos
    *,
    threads: int,
) -> Forecast:
    """Costs of a run over photos of these sizes."""
    n = len(sizes)
    exhaustive = n * (n - 1) // 2
    pairs = exhaustive if config.pairing.pairs == "exhaustive" else min(exhaustive, round(PAIRS_PER_PHOTO * n))
    structure = n * (DECODE_S + COARSE_S + FEATURES_S + MAPPING_S) + pairs * PAIR_S
    limit = config.structure.max_side or config.sources.decode_max_side
    scale = np.minimum(1.0, limit / sizes.max(axis=1))
    pixels = float(np.mean(sizes.prod(axis=1) * scale**2))
    memory = BASE_BYTES + config.training.max_splats * SPLAT_BYTES
    steps, splats = config.training.steps, MEAN_SHARE * config.training.max_splats
    training = steps * (PIXEL_S * pixels + SPLAT_S * splats) / threads**0.5  # small kernels share little
    card = steps * (CARD_S + CARD_SPLAT_S * splats)
    dense = 0.0
    if config.points.dense != "none":
        small = np.minimum(1.0, config.points.dense_max_side / sizes.max(axis=1))
        swept = min(MOST_PIXELS, float((sizes.prod(axis=1) * small**2).sum()))
        dense = swept / DENSE_PIXELS * DENSE_S * config.points.dense_partners / 4 / threads
        memory += swept * DENSE_BYTES
    return Forecast(pairs, exhaustive, structure / threads, training + dense, card + dense, memory, threads)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
