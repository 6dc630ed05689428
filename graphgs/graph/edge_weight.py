"""How well two cameras support each other: the weight of an edge of the camera graph (GraphGS, section 3.3)."""

from typing import Literal

import numpy as np

from graphgs.scene.neighbours import local_spacing

WeightMode = Literal["graphgs", "paper"]
ANGLE_FLOOR = np.deg2rad(5.0)  # below, views count as parallel: keeps the weight finite


def edge_weights(
    rotations: np.ndarray,  # [N, 3, 3] camera-from-world
    centers: np.ndarray,  # [N, 3] world
    edges: np.ndarray,  # [E, 2] int
    inliers: np.ndarray,  # [E] verified matches; without any the weight is 0
    *,
    mode: WeightMode = "graphgs",
    k: float = 1.0,  # graphgs: fall-off in camera spacings; paper: 1 / fall-off in world units
) -> np.ndarray:
    """[E] weight, larger for nearer and more parallel cameras in the `graphgs` form:
        exp(-|p_i - p_j| / (k spacing_ij)) / (1 - exp(-max(theta, 5 degrees)))
    with theta the angle between the viewing directions in rad, and spacing_ij the mean of both cameras' median distance
    to their 5 nearest centres in another place, so that scale, rotation and translation of the scene change nothing.

    `paper` is the formula as printed, exp(-k |p_i - p_j|) / (1 - exp(-d_i . d_j)). It departs from the paper's own
    words: it grows with the angle, is infinite at 90 degrees and negative beyond, and depends on the scene's scale.
    Nothing is guarded; infinities come out as they are."""
    if mode not in ("graphgs", "paper"):
        raise ValueError(f"mode: expected 'graphgs' or 'paper', got {mode!r}")
    if not k > 0:
        raise ValueError(f"k: expected more than 0, got {k}")
    i, j = edges.T
    distance = np.linalg.norm(centers[i] - centers[j], axis=1)
    d_i, d_j = rotations[i, 2], rotations[j, 2]
    dot = (d_i * d_j).sum(1)
    if mode == "paper":
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = np.exp(-k * distance) / (1.0 - np.exp(-dot))
    else:
        spacing = local_spacing(centers)
        angle = np.arctan2(np.linalg.norm(np.cross(d_i, d_j), axis=1), dot)
        near = np.exp(-distance / (k * (spacing[i] + spacing[j]) / 2))
        weight = near / (1.0 - np.exp(-np.maximum(angle, ANGLE_FLOOR)))
    return np.where(inliers > 0, weight, 0.0)


def best_partners(
    edges: np.ndarray,  # [E, 2] int
    weights: np.ndarray,  # [E]
    usable: np.ndarray,  # [E] bool: verified, between two training views
    n: int,  # cameras
    count: int,
) -> np.ndarray:
    """[N, count] int: each camera's partners of largest weight, best first, -1 where there are no more. Weights equal
    to nine digits count as equal and go by index, so that rounding does not decide between the two sides of an even
    track. A weight that is not a number comes last."""
    partners = np.full((n, count), -1, np.int64)
    if not usable.any() or count < 1:
        return partners
    edge, weight = edges[usable], np.nan_to_num(weights[usable], nan=-np.inf, posinf=np.inf, neginf=-np.inf)
    source, target = np.r_[edge[:, 0], edge[:, 1]], np.r_[edge[:, 1], edge[:, 0]]
    weight = np.r_[weight, weight]
    order = np.lexsort((target, -weight, source))
    source, target, weight = source[order], target[order], weight[order]
    falls = ~np.isclose(weight[1:], weight[:-1], rtol=1e-9, atol=0.0)
    group = np.r_[0, np.cumsum(falls | (source[1:] != source[:-1]))]
    order = np.lexsort((target, group))
    source, target = source[order], target[order]
    first = np.flatnonzero(np.r_[True, source[1:] != source[:-1]])
    rank = np.arange(len(source)) - np.repeat(first, np.diff(np.r_[first, len(source)]))
    chosen = rank < count
    partners[source[chosen], rank[chosen]] = target[chosen]
    return partners
