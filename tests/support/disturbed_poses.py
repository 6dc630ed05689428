"""Poses that are off by a known amount, and how far poses are from the truth."""

import numpy as np
from scipy.spatial.transform import Rotation

from graphgs.scene.neighbours import local_spacing
from graphgs.scene.similarity import diameter
from graphgs.scene.views import Views


def disturbed(
    views: Views,
    *,
    rotation_deg: float,
    shift: float,  # share of the largest distance between two cameras
    seed: int = 0,
) -> np.ndarray:  # [N, 4, 4]
    """Viewmats of which every training view is turned about its centre by `rotation_deg` about a random axis, and its
    centre moved by `shift` in a random direction. Held-out views keep their poses."""
    rng = np.random.default_rng(seed)
    viewmats, distance = views.viewmats.copy(), shift * diameter(views.centers)
    for i in np.flatnonzero(~views.is_test):
        axis, direction = rng.normal(size=(2, 3))
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * rotation_deg, degrees=True).as_matrix()
        center = views.centers[i] + distance * direction / np.linalg.norm(direction)
        viewmats[i, :3, :3] = turn @ viewmats[i, :3, :3]
        viewmats[i, :3, 3] = -viewmats[i, :3, :3] @ center
    return viewmats


def noisy(
    viewmats: np.ndarray,  # [N, 4, 4] world-to-camera
    noise: float,
    *,
    seed: int = 0,
) -> np.ndarray:  # [N, 4, 4]
    """Every pose turned about a random axis by up to `noise` rad, and its centre moved along each axis by up to `noise`
    spacings between cameras."""
    rng = np.random.default_rng(seed)
    centers = -np.einsum("nji,nj->ni", viewmats[:, :3, :3], viewmats[:, :3, 3])
    spacing = float(np.median(local_spacing(centers)))
    result = viewmats.copy()
    for k, center in enumerate(centers):
        axis = rng.normal(size=3)
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * rng.uniform(0, noise)).as_matrix()
        result[k, :3, :3] = turn @ viewmats[k, :3, :3]
        result[k, :3, 3] = -result[k, :3, :3] @ (center + spacing * rng.uniform(-noise, noise, 3))
    return result


def pose_errors(
    viewmats: np.ndarray,  # [N, 4, 4]
    truth: np.ndarray,  # [N, 4, 4]
) -> tuple[float, float]:
    """(rotation in degrees, position as a share of the largest distance between two cameras), means over the cameras
    after the similarity that brings them nearest: its rotation from the orientations alone, because the centres of a
    straight drive say nothing about the turn around it."""
    rotations, true_rotations = viewmats[:, :3, :3], truth[:, :3, :3]
    gauge = Rotation.from_matrix(true_rotations.swapaxes(1, 2) @ rotations).mean()
    centers, true_centers = (-np.einsum("nji,nj->ni", m[:, :3, :3], m[:, :3, 3]) for m in (viewmats, truth))
    spread, true_spread = gauge.apply(centers - centers.mean(0)), true_centers - true_centers.mean(0)
    scale = (spread * true_spread).sum() / (spread**2).sum()
    shifts = np.linalg.norm(scale * spread - true_spread, axis=1)
    turns = Rotation.from_matrix(rotations @ gauge.as_matrix().T @ true_rotations.swapaxes(1, 2))
    return float(np.degrees(turns.magnitude()).mean()), float(shifts.mean() / diameter(true_centers))
