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
from graphgs.training.draws import drawn_index

SAMPLED = 3  # best targets that "sampled" draws among


class ConsistencyTerm:
    """Compares the render of view i, warped by its depth, with its target j (METHOD 6). Raises ValueError when a test
    view would take part on either side."""

    def __init__(self, config: TrainConfig, views: Views, graph: CameraGraph, *, device: str, seed: int = 0):
        self._config, self._seed = config, seed
        self._Ks = torch.as_tensor(views.Ks, dtype=torch.float32, device=device)
        self._device = device
        count = {"max": 1, "sampled": SAMPLED, "random": len(graph.names)}[config.consistency_target]
        self._targets = target_views(views, graph, mode=config.consistency, count=count)

    def loss(
        self,
        i: int,  # the view that was rendered
        step: int,
        out: RenderOutput,  # its render, with gradients
        mask: Tensor | None,  # [1, H, W, 1] of photo i
        *,
        viewmats: np.ndarray,  # [N, 4, 4] world-to-camera, of all views as they are now
        expose: Callable[[int, Tensor], Tensor],  # the exposure of a view's photo, given to a render
        render: Callable[[int], RenderOutput],  # renders a view without gradients
        photo: Callable[[int], tuple[Tensor, Tensor | None]],  # photo and mask of a view
    ) -> Tensor | None:
        """The unweighted loss, or None for a view without a target."""
        if (j := self.target(i, step)) is None:
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

    def target(self, i: int, step: int) -> int | None:
        """The view that view i is compared with in this step; a function of the seed and the step."""
        if not (targets := self._targets.get(i)):
            return None
        return targets[0] if len(targets) == 1 else targets[drawn_index(len(targets), self._seed, step)]

    def _sources(self, rendered: Tensor, truth: Tensor | None, truth_mask: Tensor | None):
        source = self._config.consistency_source
        if source in ("render", "both"):
            yield rendered, None
        if source in ("truth", "both"):
            yield truth, truth_mask


def target_views(views: Views, graph: CameraGraph, *, mode: str, count: int = 1) -> dict[int, tuple[int, ...]]:
    """View indices of the best target cameras, at most `count`, best first, by view index, where there are any. Views
    and graph agree by name."""
    index = {name: k for k, name in enumerate(views.names)}
    view_of_node = [-1 if graph.is_test[i] else index.get(name, -1) for i, name in enumerate(graph.names)]
    targets = {}
    for i, row in enumerate(graph.top_targets(count, mode).tolist()):
        partners = tuple(index[graph.names[j]] for j in row if j >= 0 and graph.names[j] in index)
        if view_of_node[i] >= 0 and partners:
            targets[view_of_node[i]] = partners
    tested = [views.names[k] for i, partners in targets.items() for k in (i, *partners) if views.is_test[k]]
    if tested:
        raise ValueError(f"graph: test view {tested[0]} would enter the consistency loss")
    return targets
