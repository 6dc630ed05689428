"""Correcting the poses of training views while the scene is learned."""

import math

import numpy as np
import torch
from torch import Tensor

from graphgs.scene.similarity import Similarity
from graphgs.training.config import TrainConfig
from graphgs.training.whitened_steps import WhitenedSteps

FINAL_SHARE = 0.01  # of the first stride, at the last step
MEAN_SHARE = (1.0 - FINAL_SHARE) / -math.log(FINAL_SHARE)  # of all strides between, falling exponentially
_SERIES_BELOW = 1e-2  # squared angle; four terms of the series are then exact to 1e-14


class PoseRefinement:
    """Poses of the training views, moved by the gradient of their viewmats.

    A correction is a twist (translation, rotation) in the camera's frame, cam_from_world' = exp(twist) cam_from_world.
    It is folded into the pose after every update, so the gradient is always taken at zero. Moving all cameras and the
    Gaussians alike changes no image; that gauge is fixed: after every update the best similarity from the poses to the
    original ones is undone. Held-out poses, which belong to the original ones, therefore stay as they are.

    Poses are kept in float64 on the CPU: on a GPU each update waits for six numbers."""

    def __init__(
        self,
        config: TrainConfig,
        viewmats: np.ndarray,  # [N, 4, 4] world-to-camera
        is_test: np.ndarray,  # [N] bool
        *,
        extent: float,  # scene extent, world units
        device: str,
    ):
        self._config, self._extent, self._device = config, extent, device
        self._training = np.flatnonzero(~is_test)
        self._row_of_view = np.where(is_test, -1, np.cumsum(~is_test) - 1)
        self._original = viewmats.astype(np.float64)
        self.viewmats = self._original.copy()  # [N, 4, 4] as they are now
        self._optimiser = WhitenedSteps(len(self._training), 6)
        self._first_step = round(config.poses_from_fraction * config.steps)
        # A run of any length, with any number of views, can correct poses by as much.
        updates = max(1.0, (config.steps - self._first_step) / len(self._training))  # of each view, on average
        reach = [config.pose_reach * extent] * 3 + [math.radians(config.pose_reach_deg)] * 3
        self._first_strides = np.array(reach) / (MEAN_SHARE * updates)  # [6]
        self._leaf: Tensor | None = None  # [6] twist of the view that is being rendered

    def moves(self, step: int) -> bool:
        """Whether a step moves the pose of its view."""
        return step >= self._first_step

    def viewmat(self, view: int) -> Tensor:
        """[1, 4, 4] float32, with a gradient to the view's correction."""
        if self._row_of_view[view] < 0:
            raise ValueError(f"poses: view {view} is held out, so its pose is not fitted")
        self._leaf = torch.zeros(6, device=self._device, requires_grad=True)
        current = torch.as_tensor(self.viewmats[view], dtype=torch.float32, device=self._device)
        return (se3_exp(self._leaf) @ current)[None]

    def step(self, view: int, step: int, caution: float) -> None:
        """One update of the view's pose from the gathered gradient, then back to the gauge."""
        if not self.moves(step):
            return
        gradient = self._leaf.grad.double().cpu().numpy()
        self._leaf = None
        if not np.isfinite(gradient).all():
            return  # the run looks at the loss, and rolls back
        progress = (step - self._first_step) / max(1, self._config.steps - 1 - self._first_step)
        stride = self._optimiser.stride(int(self._row_of_view[view]), gradient * self._first_strides)
        twist = caution * FINAL_SHARE**progress * self._first_strides * stride
        self.viewmats[view] = se3_exp(torch.from_numpy(twist)).numpy() @ self.viewmats[view]
        self._fix_gauge()

    @property
    def is_finite(self) -> bool:
        return bool(np.isfinite(self.viewmats).all())

    def state(self) -> dict[str, Tensor]:
        return self._optimiser.state() | {"viewmats": torch.from_numpy(self.viewmats.copy())}

    def load_state(self, state: dict[str, Tensor]) -> None:
        self._optimiser.load_state(state)
        self.viewmats = state["viewmats"].numpy().copy()

    def _fix_gauge(self) -> None:
        if not self.is_finite:
            return  # the run looks at the poses, and rolls back
        poses = self.viewmats[self._training]
        gauge = pose_similarity(poses, self._original[self._training], extent=self._extent)
        self.viewmats[self._training] = moved(poses, gauge)


def se3_exp(
    twist: Tensor,  # [..., 6] translation, then rotation (an axis times its angle)
) -> Tensor:  # [..., 4, 4]
    """The exponential map of rigid motions, differentiable everywhere, at zero too."""
    rho, phi = twist[..., :3], twist[..., 3:]
    square = (phi * phi).sum(dim=-1)[..., None, None]
    small = square < _SERIES_BELOW
    angle = torch.where(small, 1.0, square).sqrt()  # a safe number where the series is taken: no NaN in its gradient
    s = torch.where(small, 1 - square / 6 * (1 - square / 20 * (1 - square / 42)), angle.sin() / angle)
    c = torch.where(small, (1 - square / 12 * (1 - square / 30 * (1 - square / 56))) / 2, (1 - angle.cos()) / angle**2)
    v = torch.where(
        small, (1 - square / 20 * (1 - square / 42 * (1 - square / 72))) / 6, (angle - angle.sin()) / angle**3
    )
    cross = _cross_matrix(phi)
    twice = cross @ cross
    identity = torch.eye(3, dtype=twist.dtype, device=twist.device)
    rotation = identity + s * cross + c * twice
    translation = (identity + c * cross + v * twice) @ rho[..., None]
    top = torch.cat([rotation, translation], dim=-1)
    bottom = top.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*top.shape[:-2], 1, 4)
    return torch.cat([top, bottom], dim=-2)


def pose_similarity(
    viewmats: np.ndarray,  # [V, 4, 4] world-to-camera
    target: np.ndarray,  # [V, 4, 4]
    *,
    extent: float,  # length that counts as much as a radian
) -> Similarity:
    """The similarity that carries the first poses onto the second with least squared error.

    Centres alone (Umeyama 1991) leave the turn about the line of a straight drive open; orientations enter the
    rotation here. Scale is taken after the rotation, which is exact in the limit of small changes."""
    centers, target_centers = _centers(viewmats), _centers(target)
    mean, target_mean = centers.mean(0), target_centers.mean(0)
    spread, target_spread = centers - mean, target_centers - target_mean
    covariance = target_spread.T @ spread / extent**2
    covariance += np.einsum("nki,nkj->ij", target[:, :3, :3], viewmats[:, :3, :3])
    u, _, vt = np.linalg.svd(covariance)
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    variance = float((spread**2).sum())
    scale = float((target_spread * (spread @ rotation.T)).sum()) / variance if variance > 0.0 else 1.0
    return Similarity(scale, rotation, target_mean - scale * rotation @ mean)


def moved(
    viewmats: np.ndarray,  # [V, 4, 4] world-to-camera
    new_from_old: Similarity,
) -> np.ndarray:  # [V, 4, 4]
    """The same cameras in another world frame."""
    rotations = viewmats[:, :3, :3] @ new_from_old.rotation.T
    result = viewmats.copy()
    result[:, :3, :3] = rotations
    result[:, :3, 3] = -np.einsum("nij,nj->ni", rotations, new_from_old.apply(_centers(viewmats)))
    return result


def _centers(viewmats: np.ndarray) -> np.ndarray:
    return -np.einsum("nji,nj->ni", viewmats[:, :3, :3], viewmats[:, :3, 3])


def _cross_matrix(vector: Tensor) -> Tensor:  # [..., 3] -> [..., 3, 3]
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).reshape(*vector.shape[:-1], 3, 3)
