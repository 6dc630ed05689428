"""What the photos say about their lenses: the information about focal length, principal point and distortion that is
left once every pose and every point may adapt to them, and what a wrong lens does to the shape of the scene.

Bundle adjustment's normal equations are formed once at a model; points are eliminated one by one, poses by a sparse
factorisation (the Schur complement, Triggs et al. 2000, Bundle Adjustment - A Modern Synthesis, section 6). Two
covariances follow. The formal one takes every observation for independent. Real errors are not: a facade with repeated
windows or a moving car pulls hundreds of tracks alike. So the tracks are put into groups by place, and what the groups
disagree about counts instead (the cluster-robust covariance, Liang and Zeger 1986).
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.calibration.points import sums
from graphgs.structure.calibration.projection import linearise

_LOSS_PX = 1.0  # scale of Cauchy's loss, as in the bundle adjustment of the ladder
_GROUPS = 12  # of tracks by place; fewer would leave the disagreement to chance
_DAMPING = 1e-9  # of the diagonal: a photo that hardly any point holds must not break the factorisation


@dataclass(frozen=True)
class LensInformation:
    """About C cameras x 5 lens coordinates (`LENS`), flattened; linear around one model."""

    information: np.ndarray  # [5C, 5C] inverse covariance if all of them were free
    scores: np.ndarray  # [G, 5C] of each group of tracks: which way it pulls
    moves: np.ndarray  # [N, 3, 5C] how far each camera moves, in world units, per unit of a coordinate
    points: np.ndarray  # [P] int: the model's points that are seen at least twice
    point_moves: np.ndarray  # [P, 3, 5C] how far each of them moves
    noise_px: float  # standard deviation of a coordinate of an observation

    def deviation(
        self,
        free: np.ndarray,  # [5C] bool; the others are held
        effects: np.ndarray,  # [E, 5C] what one unit of each coordinate does; 0 for those held
    ) -> np.ndarray:
        """[E] standard deviation of each effect: the formal or the group-robust one, whichever is larger."""
        rows = np.flatnonzero(free)
        inverse = np.linalg.pinv(self.information[np.ix_(rows, rows)], hermitian=True)
        pulls = self.scores[:, rows] - self.scores[:, rows].mean(0)
        groups = len(pulls)
        robust = inverse @ (pulls.T @ pulls) @ inverse * (groups / max(groups - 1, 1))
        wanted = effects[:, rows]
        variances = [np.einsum("ei,ij,ej->e", wanted, covariance, wanted) for covariance in (inverse, robust)]
        return np.sqrt(np.maximum(np.maximum(*variances), 0.0))


def lens_information(model: Reconstruction) -> LensInformation:
    """The information that a model's tracks hold about its cameras. Points seen once are left out."""
    track = np.repeat(np.arange(len(model.points)), model.track_lengths)
    rows = np.flatnonzero(model.track_lengths[track] >= 2)
    track, image, seen = track[rows], model.track_images[rows].astype(np.int64), model.track_xy[rows]
    middle = np.median(model.centers, axis=0)
    unit = max(float(np.linalg.norm(model.centers - middle, axis=1).max()), 1e-12)
    found = linearise(model, image, model.points[track], seen)
    weight = 1.0 / (1.0 + (found.residuals**2).sum(1) / _LOSS_PX**2) * found.ahead
    noise = _noise(found.residuals[found.ahead])
    root = (np.sqrt(weight) / noise)[:, None]
    residuals = root * found.residuals
    by_pose = root[:, :, None] * found.by_pose
    by_pose[:, :, 3:] *= unit
    by_point, by_lens = root[:, :, None] * found.by_point * unit, root[:, :, None] * found.by_lens

    n, cameras = len(model.names), len(model.cameras)
    used, track = np.unique(track, return_inverse=True)
    V = sums(by_point.transpose(0, 2, 1) @ by_point, track, len(used))
    V += (_DAMPING * np.trace(V, axis1=1, axis2=2))[:, None, None] * np.eye(3) + 1e-300 * np.eye(3)
    V_inverse = np.linalg.inv(V)
    # Observations without what their point can absorb: the columns of poses and lenses, and the residuals.
    pose_columns = 6 * image[:, None] + np.arange(6)
    lens_columns = 6 * n + 5 * model.camera_ids[image].astype(np.int64)[:, None] + np.arange(5)
    columns = np.concatenate([pose_columns, lens_columns], axis=1)  # [M, 11]
    J = np.concatenate([by_pose, by_lens], axis=2)  # [M, 2, 11]
    width = 6 * n + 5 * cameras
    H = _assembled(J.transpose(0, 2, 1) @ J, columns, columns, (width, width))
    W = _assembled(J.transpose(0, 2, 1) @ by_point, columns, 3 * track[:, None] + np.arange(3), (width, 3 * len(used)))
    V_sparse = _block_diagonal(V_inverse)
    S = (H - W @ V_sparse @ W.T).tocsc()
    pulls = J.transpose(0, 2, 1) @ residuals[:, :, None]  # [M, 11, 1]
    point_pull = sums(by_point.transpose(0, 2, 1) @ residuals[:, :, None], track, len(used))
    absorbed = (V_inverse @ point_pull)[track]  # [M, 3, 1]
    pulls = (pulls - J.transpose(0, 2, 1) @ (by_point @ absorbed))[:, :, 0]

    free = _without_gauge(model, n)
    poses, lenses = S[free][:, free], S[free][:, 6 * n :].toarray()
    poses = poses + _DAMPING * sparse.diags(np.maximum(poses.diagonal(), 1e-12))
    response = splu(poses.tocsc()).solve(lenses) if len(free) else lenses  # [F, 5C]
    information = S[6 * n :, 6 * n :].toarray() - lenses.T @ response
    full = np.zeros((6 * n, 5 * cameras))
    full[free] = -response
    groups = groups_by_place(model.points[used])[track]
    scores = np.zeros((int(groups.max(initial=-1)) + 1, 5 * cameras))
    adapted = np.concatenate([full, np.eye(5 * cameras)])  # [width, 5C]: everything that follows a change of a lens
    for group in range(len(scores)):
        here = groups == group
        total = np.bincount(columns[here].ravel(), pulls[here].ravel(), minlength=width)
        scores[group] = total @ adapted
    point_moves = -(V_sparse @ (W.T @ adapted)).reshape(len(used), 3, -1) * unit
    moves = full.reshape(n, 6, -1)[:, 3:] * unit
    return LensInformation(information, scores, moves, used, point_moves, noise)


def _noise(residuals: np.ndarray) -> float:
    """[px] robust standard deviation of one coordinate."""
    return max(1.4826 * float(np.median(np.abs(residuals))), 1e-3) if len(residuals) else 1.0


def _assembled(blocks: np.ndarray, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> sparse.csr_matrix:
    """The sum of dense blocks [M, a, b] at rows [M, a] and columns [M, b]."""
    r = np.broadcast_to(rows[:, :, None], blocks.shape).ravel()
    c = np.broadcast_to(columns[:, None, :], blocks.shape).ravel()
    return sparse.coo_matrix((blocks.ravel(), (r, c)), shape=shape).tocsr()


def _block_diagonal(blocks: np.ndarray) -> sparse.csr_matrix:
    count, size, _ = blocks.shape
    return sparse.bsr_matrix(
        (blocks, np.arange(count), np.arange(count + 1)), shape=(count * size, count * size)
    ).tocsr()


def _without_gauge(model: Reconstruction, n: int) -> np.ndarray:
    """The columns of poses without those that only move, turn or scale the world: one camera is held, and of the one
    farthest from it the coordinate that lies farthest."""
    away = model.centers - model.centers[0]
    farthest = int(np.linalg.norm(away, axis=1).argmax())
    held = [*range(6), 6 * farthest + 3 + int(np.abs(away[farthest]).argmax())]
    return np.setdiff1d(np.arange(6 * n), held)


def groups_by_place(points: np.ndarray) -> np.ndarray:
    """[P] int: points of one region each, of even numbers, halved along the longest side again and again."""
    labels = np.zeros(len(points), np.int64)
    parts = [np.arange(len(points))]
    while len(parts) < _GROUPS and max(len(part) for part in parts) >= 2:
        part = parts.pop(int(np.argmax([len(p) for p in parts])))
        spread = np.percentile(points[part], 90, axis=0) - np.percentile(points[part], 10, axis=0)
        order = part[np.argsort(points[part, int(spread.argmax())], kind="stable")]
        parts += [order[: len(order) // 2], order[len(order) // 2 :]]
    for label, part in enumerate(parts):
        labels[part] = label
    return labels
