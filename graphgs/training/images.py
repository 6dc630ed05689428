"""Training images on their way from the disk to the loss."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import torch
from torch import Tensor

from graphgs.scene.views import ImageCache, Views


class TrainingImages:
    """Photos by view index, the next step's decoded in the background. Only the worker thread touches the cache.

    A card keeps the photos it was sent, as bytes, within the same budget: a step then waits for no transfer."""

    def __init__(self, views: Views, *, budget_bytes: int, view_of_step: Callable[[int], int], device: str):
        self._cache = ImageCache(views, budget_bytes=budget_bytes)
        self._on_card: dict[int, tuple[Tensor, Tensor | None]] = {}  # uint8, bool
        self._card_bytes = budget_bytes if torch.device(device).type == "cuda" else 0  # left
        self._view_of_step, self._device = view_of_step, device
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="decode")
        self._next: tuple[int, Future] | None = None

    def of_step(self, step: int) -> tuple[int, Tensor, Tensor | None]:
        """(view, photo [1, H, W, 3] in 0..1, mask [1, H, W, 1] or None) of an executed step."""
        if self._on_card and (view := self._view_of_step(step)) in self._on_card:
            return view, *_as_real(*self._on_card[view])
        if self._next is None or self._next[0] != step:
            self._prefetch(step)
        view, image, mask = self._next[1].result()
        self._prefetch(step + 1)
        return view, *self._upload(view, image, mask)

    def of_view(self, view: int) -> tuple[Tensor, Tensor | None]:
        """(photo [1, H, W, 3] in 0..1, mask [1, H, W, 1] or None)."""
        if view in self._on_card:
            return _as_real(*self._on_card[view])
        return self._upload(view, *self._worker.submit(self._cache.get, view).result())

    def close(self) -> None:
        self._worker.shutdown(wait=True, cancel_futures=True)

    def _prefetch(self, step: int) -> None:
        self._next = (step, self._worker.submit(self._load, step))

    def _load(self, step: int) -> tuple[int, np.ndarray, np.ndarray | None]:
        view = self._view_of_step(step)
        return view, *self._cache.get(view)

    def _upload(self, view: int, image: np.ndarray, mask: np.ndarray | None) -> tuple[Tensor, Tensor | None]:
        photo = torch.from_numpy(image).to(self._device)
        mask = None if mask is None else torch.from_numpy(mask).to(self._device)
        size = photo.nbytes + (0 if mask is None else mask.nbytes)
        if size <= self._card_bytes and view not in self._on_card:
            self._on_card[view] = photo, mask
            self._card_bytes -= size
        return _as_real(photo, mask)


def _as_real(photo: Tensor, mask: Tensor | None) -> tuple[Tensor, Tensor | None]:
    return photo[None].float().div_(255.0), None if mask is None else mask[None, ..., None].float()
