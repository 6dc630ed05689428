"""Relative poses of image pairs from any model, and the global coarse poses they add up to.

The protocol, one function in a file of the user's:

    def estimate(paths: list[Path], pairs: np.ndarray) -> RelativePoses

`paths` [N] are the decoded photos (8-bit RGB PNG, upright), `pairs` [P, 2] index them. With `--prior
learned=FILE.py:estimate` it is called once; what it returns chooses the pairs to match, and nothing else.
`graphgs.learned.pointmaps` and `graphgs.learned.vggt` make such functions of models with DUSt3R's, MASt3R's and VGGT's
interfaces.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import block_diag, coo_matrix, identity, kron
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.sparse.linalg import lsqr, splu
from scipy.spatial.transform import Rotation

from graphgs.errors import DataError, UsageError
from graphgs.structure.components import components

_ROUNDS = 30  # of reweighting; both averages settle in fewer
_SMALLEST_RAD = 1e-3  # differences below count as none: weights stay bounded
_SMALLEST_STEP = 1e-3  # likewise, of a baseline
_NEARLY = 1.0 - 1e-6  # keeps the equations solvable where no pair is short


@dataclass(frozen=True)
class RelativePoses:
    """What a model says about pairs of images."""

    pairs: np.ndarray  # [P, 2] int, i and j
    rotations: np.ndarray  # [P, 3, 3] cam_j_from_cam_i
    translations: np.ndarray  # [P, 3] cam_j_from_cam_i, any length: only the direction is used
    confidence: np.ndarray  # [P] 0 = no pose found; any scale, larger is better

    def checked(self, n: int) -> "RelativePoses":
        """With float64 arrays, and only pairs that have a pose. Raises ValueError for shapes or indices that do not
        fit."""
        pairs, confidence = np.asarray(self.pairs), np.asarray(self.confidence, dtype=np.float64)
        rotations, translations = (np.asarray(a, dtype=np.float64) for a in (self.rotations, self.translations))
        count = len(pairs)
        for name, array, shape in (
            ("pairs", pairs, (count, 2)),
            ("rotations", rotations, (count, 3, 3)),
            ("translations", translations, (count, 3)),
            ("confidence", confidence, (count,)),
        ):
            if array.shape != shape:
                raise ValueError(f"{name}: expected {list(shape)}, got {list(array.shape)}")
        if count and (pairs.min() < 0 or pairs.max() >= n or (pairs[:, 0] == pairs[:, 1]).any()):
            raise ValueError(f"pairs: expected two different indices in 0..{n - 1}")
        length = np.linalg.norm(translations, axis=1)
        usable = np.isfinite(confidence) & (confidence > 0) & np.isfinite(rotations).all((1, 2)) & (length > 0)
        return RelativePoses(
            pairs[usable].astype(np.int64),
            rotations[usable],
            translations[usable] / length[usable, None],
            confidence[usable],
        )


Estimate = Callable[[list[Path], np.ndarray], RelativePoses]


def load_estimate(wanted: str) -> Estimate:
    """The function of "FILE.py:FUNCTION". Raises UsageError."""
    file, _, name = wanted.rpartition(":")
    hint = "--prior learned=FILE.py:FUNCTION names a Python file with a function of paths and pairs"
    if not file.endswith(".py") or not Path(file).is_file():
        raise UsageError(f"--prior learned={wanted}: there is no such Python file", hint=hint)
    spec = importlib.util.spec_from_file_location(Path(file).stem, file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if not callable(getattr(module, name, None)):
        raise UsageError(f"{file} has no function {name}", hint=hint)
    return getattr(module, name)


def global_poses(relative: RelativePoses, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(placed [N] bool, rotations [N, 3, 3] camera-from-world, centers [N, 3]) of the largest connected group.

    Rotations by reweighted averaging from a spanning tree (Chatterjee and Govindu 2013), centres by least unsquared
    deviations from the directions (Ozyesil and Singer 2015). Raises DataError when fewer than three images hang
    together."""
    relative = relative.checked(n)
    group = components(n, relative.pairs)[0]
    if len(group) < 3:
        raise DataError(
            "the model's relative poses connect no three photos", hint="check its weights, or use --prior auto"
        )
    local = np.full(n, -1)
    local[group] = np.arange(len(group))
    inside = local[relative.pairs[:, 0]] >= 0
    pairs = local[relative.pairs[inside]]
    weight = relative.confidence[inside] / relative.confidence[inside].max()
    own = average_rotations(pairs, relative.rotations[inside], weight, len(group))
    # cam_j_from_cam_i maps the centre of i to t in camera j, so from j to i it is R_j^T t in the world.
    directions = -np.einsum("pji,pj->pi", own[pairs[:, 1]], relative.translations[inside])
    placed = np.zeros(n, dtype=bool)
    placed[group] = True
    rotations, centers = np.tile(np.eye(3), (n, 1, 1)), np.full((n, 3), np.nan)
    rotations[group], centers[group] = own, average_centers(pairs, directions, weight, len(group))
    return placed, rotations, centers


def average_rotations(pairs: np.ndarray, relative: np.ndarray, weight: np.ndarray, n: int) -> np.ndarray:
    """[N, 3, 3] camera-from-world with R_j R_i^T close to `relative` [P, 3, 3]; the first is the identity."""
    rotations = _spanning(pairs, relative, weight, n)
    i, j = pairs.T
    rows = np.repeat(np.arange(len(pairs)), 2)
    for _ in range(_ROUNDS):
        # The update of camera k is exp(w_k) R_k; to first order the error of an edge changes by w_j - R_ij w_i, and as
        # seen in the world by w'_j - w'_i with w' = R^T w.
        error = rotations[j] @ rotations[i].transpose(0, 2, 1) @ relative.transpose(0, 2, 1)
        turn = Rotation.from_matrix(error).as_rotvec()
        size = np.maximum(np.linalg.norm(turn, axis=1), _SMALLEST_RAD)
        scale = np.sqrt(weight / size)
        signs = np.tile([-1.0, 1.0], len(pairs)) * np.repeat(scale, 2)
        system = coo_matrix((signs, (rows, pairs.ravel())), shape=(len(pairs), n)).tocsr()[:, 1:]
        wanted = -np.einsum("pji,pj->pi", rotations[j], turn) * scale[:, None]
        step = np.stack([lsqr(system, wanted[:, axis])[0] for axis in range(3)], axis=1)
        step = np.concatenate([np.zeros((1, 3)), step])
        rotations = rotations @ Rotation.from_rotvec(step).as_matrix()
        if np.abs(step).max() < 1e-6:
            break
    return rotations


def average_centers(pairs: np.ndarray, directions: np.ndarray, weight: np.ndarray, n: int) -> np.ndarray:
    """[N, 3] centres whose differences c_j - c_i point along `directions` [P, 3], each at least 1 long; c_0 = 0.

    Newton's method on sums of squares with reweighting: a pair that is long enough objects to sideways errors only, a
    shorter one to its length as well."""
    rows, signs = np.repeat(np.arange(len(pairs)), 2), np.tile([-1.0, 1.0], len(pairs))
    difference = coo_matrix((signs, (rows, pairs.ravel())), shape=(len(pairs), n)).tocsr()[:, 1:]
    spread = kron(difference, identity(3), format="csr")
    outer = directions[:, :, None] * directions[:, None, :]
    long_enough, scale = np.zeros(len(pairs)), weight
    for _ in range(_ROUNDS):
        blocks = scale[:, None, None] * (np.eye(3) - long_enough[:, None, None] * outer)
        metric = block_diag(list(blocks), format="csr")
        wanted = (scale * (1.0 - long_enough))[:, None] * directions
        found = splu((spread.T @ metric @ spread).tocsc()).solve(spread.T @ wanted.ravel()).reshape(-1, 3)
        reached = difference @ found
        along = (reached * directions).sum(1)
        miss = np.linalg.norm(reached - np.maximum(along, 1.0)[:, None] * directions, axis=1)
        scale = weight / np.maximum(miss, _SMALLEST_STEP * np.maximum(along, 1.0))
        long_enough = np.where(along > 1.0, _NEARLY, 0.0)
    return np.concatenate([np.zeros((1, 3)), found])


def _spanning(pairs: np.ndarray, relative: np.ndarray, weight: np.ndarray, n: int) -> np.ndarray:
    """[N, 3, 3] rotations along the tree of the most confident edges."""
    order = np.argsort(weight, kind="stable")  # of a pair named twice the better one counts
    best = {tuple(sorted(pair)): k for k, pair in zip(order, pairs[order].tolist(), strict=True)}
    chosen = np.array(list(best.values()))
    cost = 2.0 - weight[chosen]  # positive, and smaller for more confident edges
    tree = minimum_spanning_tree(coo_matrix((cost, pairs[chosen].T), shape=(n, n)).tocsr())
    sequence, parent = breadth_first_order(tree, 0, directed=False)
    rotations = np.tile(np.eye(3), (n, 1, 1))
    for k in sequence[1:]:
        p = best[tuple(sorted((int(k), int(parent[k]))))]
        turn = relative[p] if pairs[p, 1] == k else relative[p].T
        rotations[k] = turn @ rotations[parent[k]]
    return rotations
