"""Forward and backward passes of a loss, and of its float64 twin in the same run."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from bench.metrics import Metric
from bench.timing import TOLERANCE, median_ms, median_time, time_metrics


def loss_metrics(
    key: str,
    loss: Callable[[], Tensor],  # scalar
    leaves: Sequence[Tensor],
    *,
    device: str,
    repeats: int = 15,
) -> list[Metric]:
    value = loss()

    def backward() -> None:
        torch.autograd.grad(value, leaves, retain_graph=True)

    forward_time = median_time(loss, repeats=repeats, device=device)
    backward_time = median_time(backward, repeats=repeats, device=device)
    return time_metrics(f"{key}/forward", forward_time) + time_metrics(f"{key}/backward", backward_time)


def twin_metrics(
    key: str,  # the loss's, of the same size
    metrics: Sequence[Metric],  # of the loss
    twin: Callable[[], Tensor],  # on the CPU, on as many threads as torch likes
    leaves: Sequence[Tensor],
) -> list[Metric]:
    """The twin, forward and backward together, and how many times faster the loss is."""
    slow = median_ms(lambda: torch.autograd.grad(twin(), leaves), repeats=3, warmup=1)
    fast = sum(m.value for m in metrics if m.name in (f"{key}/forward", f"{key}/backward"))
    return [
        Metric(f"{key}/twin", slow, "ms", "lower", 1.0),
        Metric(f"{key}/times the twin", slow / fast, "x", "higher", 2 * TOLERANCE),
    ]
