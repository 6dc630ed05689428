"""The multi-view consistency term: each training view and its target camera."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from graphgs.graph import CameraGraph
from graphgs.losses import consistency_loss
from graphgs.rendering import RenderOutput
from graphgs.scene.views import Views
from graphgs.training.config import TrainConfig


class ConsistencyTerm:
    """Compares the render of view i, warped by its depth, with its target j (METHOD 6). Raises ValueError when a test
    view would take part on either side."""

    def __init__(self, config: TrainConfig, views: Views, graph: CameraGraph, *, device: str):
        self._config, self._views = config, views
        self._Ks = torch.as_tensor(views.Ks, dtype=torch.float32, device=device)
        self._device = device
        self._targets = target_views(views, graph, mode=config.consistency)

    def loss(
        self,
        i: int,  # the view that was rendered
        out: RenderOutput,  # its render, with gradients
        mask: Tensor | None,  # [1, H, W, 1] of photo i
        *,
        viewmats: np.ndarray,  # [N, 4, 4] world-to-camera, of all views as they are now
        expose: Callable[[int, Tensor], Tensor],  # the exposure of a view's photo, given to a render
        render: Callable[[int], RenderOutput],  # renders a view without gradients
        photo: Callable[[int], tuple[Tensor, Tensor | None]],  # photo and mask of a view
    ) -> Tensor | None:
        """The unweighted loss, or None for a view without a target."""
        j = self._targets.get(i)
        if j is None:
            return None
        cam_j_from_cam_i = viewmats[j] @ np.linalg.inv(viewmats[i])
        geometry = (
            self._Ks[i : i + 1],
            self._Ks[j : j + 1],
            torch.as_tensor(cam_j_from_cam_i, dtype=torch.float32, device=self._device)[None],
        )
        alpha_i = out.alphas if mask is None else out.alphas * mask
        other = render(j)
        truth, truth_mask = (None, None) if self._config.consistency_source == "render" else photo(j)
        losses = []
        for image_j, mask_j in self._sources(other.colors, truth, truth_mask):
            # two renders meet without any exposure; photo j meets render i as camera j would have exposed it
            image_i = out.colors if image_j is other.colors else expose(j, out.colors)
            # depth 0 says "nothing here", which the occlusion check then drops
            depth_j = other.depths if mask_j is None else other.depths * mask_j
            losses.append(
                consistency_loss(
                    image_i, out.depths, alpha_i, image_j, depth_j, *geometry, mode=self._config.consistency
                )
            )
        return losses[0] if len(losses) == 1 else (losses[0] + losses[1]) / 2

    def _sources(self, rendered: Tensor, truth: Tensor | None, truth_mask: Tensor | None):
        source = self._config.consistency_source
        if source in ("render", "both"):
            yield rendered, None
        if source in ("truth", "both"):
            yield truth, truth_mask


def target_views(views: Views, graph: CameraGraph, *, mode: str) -> dict[int, int]:
    """View index of the target camera by view index, where there is one. Views and graph agree by name."""
    index = {name: k for k, name in enumerate(views.names)}
    targets = graph.targets(mode=mode)
    pairs = {
        index[graph.names[i]]: index[graph.names[int(j)]]
        for i, j in enumerate(targets)
        if j >= 0 and not graph.is_test[i] and graph.names[i] in index and graph.names[int(j)] in index
    }
    tested = [views.names[k] for pair in pairs.items() for k in pair if views.is_test[k]]
    if tested:
        raise ValueError(f"graph: test view {tested[0]} would enter the consistency loss")
    return pairs
