"""What a lens that may be wrong does to the shape of the scene, in words: a stretch along the drive, bent heights."""

from dataclasses import dataclass

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.calibration.information import LensInformation

_KEPT = (5.0, 95.0)  # percentiles: the spread of a scene must not hang on its outliers
_WORTH_SAYING = 0.02  # of the scene: less hardly shows


@dataclass(frozen=True)
class ShapeChange:
    """How the scene changes its shape, once moving, turning and scaling all of it is taken out."""

    stretch: float  # by which share one direction grows against the one across it that grows least
    bend: float  # how far the cameras leave their plane or line, as a share of the scene's length
    length: float  # of the scene, world units

    @property
    def matters(self) -> bool:
        return max(self.stretch, self.bend) >= _WORTH_SAYING

    def describe(self, unit: str, scale: float = 1.0) -> str:
        """e.g. "the scene may be stretched by 12 %"; `unit` of the world, "" if it has none, which is larger by `scale`
        than the one this was found in."""
        said = []
        if self.stretch >= _WORTH_SAYING:
            said.append(f"the scene may be stretched along one direction by {_percent(self.stretch)}")
        if self.bend >= _WORTH_SAYING:
            size = f"{self.bend * self.length * scale:.1f} {unit}" if unit else f"{_percent(self.bend)} of its length"
            said.append(f"heights may bend by {size}")
        return " and ".join(said)


def shape_change(
    model: Reconstruction,
    information: LensInformation,
    change: np.ndarray,  # [5C] of the lens coordinates
) -> ShapeChange:
    """To first order, with everything that is not held following the change."""
    where = np.concatenate([model.centers, model.points[information.points]])
    moves = np.concatenate([information.moves @ change, information.point_moves @ change])
    low, high = np.percentile(where, _KEPT, axis=0)
    near = ((where >= low - (high - low)) & (where <= high + (high - low))).all(1) & np.isfinite(moves).all(1)
    length = float(np.linalg.norm(high - low))
    if near.sum() < 4 or length <= 0:
        return ShapeChange(0.0, 0.0, length)
    where, moves = where[near], moves[near]
    offset = where - np.median(where, axis=0)
    moves = moves - _similarity(offset, moves)
    linear = _robust_linear(offset, moves)
    strains = np.linalg.eigvalsh((linear + linear.T) / 2)
    # Of a direction in which the scene hardly extends nothing is known but how far things move in all.
    most = 6.0 * float(np.percentile(np.linalg.norm(moves, axis=1), _KEPT[1])) / length
    cameras = int(near[: len(model.centers)].sum())
    return ShapeChange(
        min(float(strains[-1] - strains[0]), most), _bend(offset[:cameras], moves[:cameras]) / length, length
    )


def _similarity(offset: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """[M, 3] the part of the moves that a small shift, turn and scaling of all explains best."""
    x, y, z = offset.T
    one, none = np.ones(len(offset)), np.zeros(len(offset))
    rows = [[one, none, none, none, z, -y, x], [none, one, none, -z, none, x, y], [none, none, one, y, -x, none, z]]
    design = np.concatenate([np.stack(row, axis=1) for row in rows])
    solution = np.linalg.lstsq(design, moves.T.ravel(), rcond=1e-9)[0]
    return (design @ solution).reshape(3, -1).T


def _robust_linear(offset: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """[3, 3] the linear map that takes offsets to moves best, a constant aside; far points weigh no more than near."""
    design = np.column_stack([offset, np.ones(len(offset))])
    scale = np.linalg.norm(offset, axis=1) + np.median(np.linalg.norm(offset, axis=1)) + 1e-12
    weight = 1.0 / scale
    for _ in range(4):
        solution = np.linalg.lstsq(design * weight[:, None], moves * weight[:, None], rcond=1e-9)[0]
        rest = np.linalg.norm(moves - design @ solution, axis=1) / scale
        weight = 1.0 / scale / np.sqrt(1.0 + (rest / (np.median(rest) + 1e-12)) ** 2)
    return solution[:3].T


def _bend(offset: np.ndarray, moves: np.ndarray) -> float:
    """How far cameras move by the square of their distance from the middle, across the plane or line they lie on."""
    if len(offset) < 6:
        return 0.0
    middle = offset.mean(0)
    axes = np.linalg.svd(offset - middle, full_matrices=False)[2]
    along = (offset - middle) @ axes[:2].T
    radius2 = (along**2).sum(1)
    design = np.column_stack([np.ones(len(along)), along, radius2])
    solution = np.linalg.lstsq(design, moves, rcond=1e-9)[0]
    return float(np.abs(solution[3] @ axes[1:].T).max() * radius2.max())


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.02 else f"{100 * share:.1f} %"
