"""Rendered depth against the surfaces that photos agree on (decisions/0032)."""

import numpy as np
import torch
from torch import Tensor

from graphgs.points import DenseCloud
from graphgs.rendering import RenderOutput
from graphgs.scene.views import Views
from graphgs.training.config import TrainConfig

MIN_ALPHA = 0.5  # a fainter pixel's expected depth says little
MOST_ERROR = 0.5  # of the log of the depth: what is farther off is another surface, or a wrong match
FINAL_SHARE = 0.01  # of the weight, at the last step: the end belongs to the photos


class SurfaceDepth:
    """For each training view, the pixels whose surface is known and their depths; nothing of held-out views."""

    def __init__(self, config: TrainConfig, views: Views, surfaces: DenseCloud, *, device: str):
        self._config = config
        self._known: dict[int, tuple[Tensor, Tensor]] = {}
        by_view = np.argsort(surfaces.views, kind="stable")
        bounds = np.searchsorted(surfaces.views[by_view], np.arange(len(views.names) + 1))
        for i in np.flatnonzero(~views.is_test):
            points = surfaces.positions[by_view[bounds[i] : bounds[i + 1]]]
            in_camera = points @ views.viewmats[i, :3, :3].T + views.viewmats[i, :3, 3]
            pixels = in_camera @ views.Ks[i].T
            columns, rows = np.floor(pixels[:, :2] / pixels[:, 2:]).astype(np.int64).T
            width, height = views.sizes[i]
            inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
            if inside.any():
                index = torch.from_numpy(rows[inside] * int(width) + columns[inside]).to(device)
                depth = torch.as_tensor(in_camera[inside, 2], dtype=torch.float32, device=device)
                self._known[int(i)] = index, torch.log(depth)

    def weight(self, step: int) -> float:
        """Of the loss; falls exponentially from the first step on whole photos to the last."""
        first = round(self._config.warm_up_fraction * self._config.steps)
        return self._config.lambda_depth * FINAL_SHARE ** ((step - first) / max(1, self._config.steps - 1 - first))

    def loss(self, view: int, out: RenderOutput) -> Tensor | None:
        """Mean difference of the logs of rendered and known depth; None for a view without known surfaces.

        Differences beyond MOST_ERROR have no gradient, nor have pixels that are hardly covered."""
        if view not in self._known:
            return None
        index, log_depth = self._known[view]
        depth = out.depths.reshape(-1)[index]
        covered = (out.alphas.detach().reshape(-1)[index] >= MIN_ALPHA) & (depth.detach() > 0)
        error = (torch.log(torch.where(covered, depth, 1.0)) - log_depth).abs().clamp(max=MOST_ERROR)
        return (error * covered).sum() / len(index)
