"""Random numbers of a training step, from the seed and the step alone, so that a resumed run draws the same."""

import torch
from torch import Tensor


def generator_of(seed: int, step: int) -> torch.Generator:
    """On the CPU, whatever the device: the same numbers everywhere."""
    return torch.Generator().manual_seed((seed * 1_000_003 + step) % 2**63)


def draw_rows(
    weights: Tensor,  # [N] not negative, not all zero
    count: int,
    generator: torch.Generator,
) -> Tensor:
    """[count] int64: rows drawn in proportion to their weights, with replacement."""
    summed = torch.cumsum(weights.double().cpu(), dim=0)
    shots = torch.rand(count, generator=generator, dtype=torch.float64) * summed[-1]
    rows = torch.searchsorted(summed, shots, right=True)
    last = int(torch.nonzero(weights)[-1, 0])  # a shot may round up to the sum: never past the last row with weight
    return rows.clamp_(max=last).to(weights.device)


def drawn_index(count: int, seed: int, step: int) -> int:
    """One of 0 .. count - 1, all alike."""
    return int(torch.randint(count, (1,), generator=generator_of(seed, step)))
