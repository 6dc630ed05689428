"""Gaussians that hang in free space: too near to a training camera, or seen by one view where its neighbours in the
camera graph should see them, too."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from graphgs.graph import CameraGraph
from graphgs.rendering import RenderOutput
from graphgs.scene.views import Views

ONE_VIEW_SHARE = 0.9  # of a Gaussian's pixels, in one view: only this one needs it
CONFIRMING_VIEWS = 2  # neighbours of that view which should see it before their silence counts
CLEARLY_IN_FRONT = 0.95  # of the depth at which half of the light is gone: nothing hides it there


@dataclass(frozen=True)
class FloaterFinder:
    """The training views as judges of free space. Held-out views are never asked."""

    views: Views
    graph: CameraGraph
    nears: np.ndarray  # [N] camera z below which a view sees no surface, world units; NaN = not known

    def too_near(
        self,
        means: Tensor,  # [G, 3] world
    ) -> Tensor:
        """[G] bool: in the frustum of a training view, nearer than its near depth."""
        found = torch.zeros(len(means), dtype=torch.bool, device=means.device)
        for i in np.flatnonzero(np.isfinite(self.nears) & ~self.views.is_test):
            depths, pixels = self._project(int(i), means)
            found |= self._inside(int(i), depths, pixels) & (depths < float(self.nears[i]))
        return found

    def unconfirmed(
        self,
        means: Tensor,  # [G, 3] world
        render: Callable[[int, Tensor], RenderOutput],  # view and colors [G, 1], with median depth; detached Gaussians
    ) -> Tensor:
        """[G] bool: one view has nearly all pixels of it, although several of that view's neighbours in the verified
        graph contain it in front of all they see. Renders every training view once."""
        count = len(means)
        total, most = torch.zeros(count, device=means.device), torch.zeros(count, device=means.device)
        where = torch.full((count,), -1, device=means.device)
        expected = {}  # packed bits [G / 8] by view
        training = np.flatnonzero(~self.views.is_test).tolist()
        for i in training:
            weights, in_front = self._look(i, means, render)
            total += weights
            where = torch.where(weights > most, i, where)
            most = torch.maximum(most, weights)
            expected[i] = np.packbits(in_front.cpu().numpy())
        neighbors = torch.from_numpy(self._neighbors()).to(means.device)
        witnesses = torch.zeros(count, dtype=torch.int64, device=means.device)
        for j in training:
            in_front = torch.from_numpy(np.unpackbits(expected[j], count=count).astype(bool)).to(means.device)
            witnesses += in_front & neighbors[where, j] & (where >= 0)
        return (most > ONE_VIEW_SHARE * total) & (witnesses >= CONFIRMING_VIEWS)

    def _look(self, i: int, means: Tensor, render: Callable[[int, Tensor], RenderOutput]) -> tuple[Tensor, Tensor]:
        """[G] pixels that view i takes from each Gaussian; [G] bool: whether it lies in front of all that i sees."""
        with torch.enable_grad():  # the sum of an image's derivative in a colour is that Gaussian's sum of weights
            colors = torch.ones(len(means), 1, device=means.device, requires_grad=True)
            out = render(i, colors)
            out.colors.sum().backward()
        depths, pixels = self._project(i, means)
        inside = self._inside(i, depths, pixels)
        column, row = pixels[inside].long().unbind(-1)
        surface = out.median_depths[0, row, column, 0].detach()
        in_front = inside.clone()
        in_front[inside] = (depths[inside] < CLEARLY_IN_FRONT * surface) | (surface == 0.0)
        return colors.grad[:, 0], in_front

    def _project(self, i: int, means: Tensor) -> tuple[Tensor, Tensor]:
        """([G] camera z, [G, 2] px) in view i."""
        viewmat = torch.as_tensor(self.views.viewmats[i], dtype=means.dtype, device=means.device)
        K = torch.as_tensor(self.views.Ks[i], dtype=means.dtype, device=means.device)
        in_camera = means @ viewmat[:3, :3].T + viewmat[:3, 3]
        projected = in_camera @ K.T
        return in_camera[:, 2], projected[:, :2] / projected[:, 2:]

    def _inside(self, i: int, depths: Tensor, pixels: Tensor) -> Tensor:
        size = torch.as_tensor(self.views.sizes[i], device=pixels.device)
        return (depths > 0.0) & ((pixels >= 0.0) & (pixels < size)).all(dim=-1)

    def _neighbors(self) -> np.ndarray:
        """[N, N] bool, by view: verified pairs of training views."""
        index = {name: k for k, name in enumerate(self.views.names)}
        of_node = np.array([index.get(name, -1) for name in self.graph.names])
        joined = np.zeros((len(self.views.names),) * 2, dtype=bool)
        ends = of_node[self.graph.edges[self.graph.inliers > 0]]
        ends = ends[(ends >= 0).all(axis=1)]
        joined[ends[:, 0], ends[:, 1]] = joined[ends[:, 1], ends[:, 0]] = True
        return joined
