"""A prepared scene as a case wants it: other points, fewer photos, disturbed poses or exposures. Drawn once: all seeds
of a case train on the same input."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from bench.quality_cases import Case
from bench.quality_scenes import Scene, every_point
from graphgs.graph import CameraGraph
from graphgs.points import PrunedPoints
from graphgs.scene.neighbours import local_spacing
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.views import Views
from graphgs.synth.street import GAMMA
from tests.support.disturbed_poses import disturbed

DISTURBED_DEG, DISTURBED_SHIFT = 0.5, 0.01  # of a pose: turn, and shift in largest distances between cameras


@dataclass(frozen=True)
class Inputs:
    views: Views
    graph: CameraGraph
    points: PrunedPoints


def inputs_of(
    case: Case,
    scene: Scene,
    folder: Path,  # for altered photos
) -> Inputs:
    views, graph, model = scene.views, scene.graph, scene.model
    if case.keep_every > 1:
        rows = _kept(views.is_test, case.keep_every)
        views, graph = _view_rows(views, rows), _graph_rows(graph, rows)
        points = every_point(model, _seen_twice(model, rows[~scene.views.is_test[rows]]))
    elif case.points in scene.points:
        points = scene.points[case.points]
    elif case.points == "random":
        count = len(scene.points["octree"].positions)
        points = every_point(model, np.random.default_rng(0).choice(len(model.points), count, replace=False))
    else:
        points = every_point(model)
    if case.disturbed:
        moved = disturbed(views, rotation_deg=DISTURBED_DEG, shift=DISTURBED_SHIFT)
        views, graph = _with_poses(views, graph, moved)
    if case.noise:
        views, graph = _with_poses(views, graph, _noisy(views, case.noise))
    if case.exposure_stops:
        views = _exposed(views, case.exposure_stops, folder)
    return Inputs(views, graph, points)


def _kept(is_test: np.ndarray, every: int) -> np.ndarray:
    """Held-out views and every n-th of the others, in order."""
    return np.sort(np.r_[np.flatnonzero(is_test), np.flatnonzero(~is_test)[::every]])


def _view_rows(views: Views, rows: np.ndarray) -> Views:
    texts = {k: tuple(getattr(views, k)[i] for i in rows) for k in ("names", "images", "masks")}
    arrays = {k: getattr(views, k)[rows] for k in ("sizes", "Ks", "viewmats", "is_test")}
    return dataclasses.replace(views, **texts, **arrays)


def _graph_rows(graph: CameraGraph, rows: np.ndarray) -> CameraGraph:
    """What is left of the graph: the verified pairs among these views."""
    index = np.full(len(graph.names), -1)
    index[rows] = np.arange(len(rows))
    edges = index[graph.edges]
    kept = (edges >= 0).all(1)
    return CameraGraph(
        tuple(graph.names[i] for i in rows), graph.rotations[rows], graph.centers[rows], edges[kept],
        graph.inliers[kept], graph.is_test[rows],
    )  # fmt: skip


def _seen_twice(model: Reconstruction, images: np.ndarray) -> np.ndarray:
    """Rows of the points that at least two of these images see."""
    seen = np.isin(model.track_images, images)
    point = np.repeat(np.arange(len(model.points)), model.track_lengths)
    return np.flatnonzero(np.bincount(point[seen], minlength=len(model.points)) >= 2)


def _with_poses(views: Views, graph: CameraGraph, viewmats: np.ndarray) -> tuple[Views, CameraGraph]:
    views = dataclasses.replace(views, viewmats=viewmats)
    return views, dataclasses.replace(graph, rotations=viewmats[:, :3, :3], centers=views.centers)


def _noisy(views: Views, noise: float) -> np.ndarray:
    """[N, 4, 4] every pose, held-out ones too, turned about a random axis by up to `noise` rad, and its centre moved
    along each axis by up to `noise` spacings between cameras."""
    rng = np.random.default_rng(0)
    spacing = float(np.median(local_spacing(views.centers)))
    viewmats = views.viewmats.copy()
    for k, center in enumerate(views.centers):
        axis = rng.normal(size=3)
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * rng.uniform(0, noise)).as_matrix()
        viewmats[k, :3, :3] = turn @ viewmats[k, :3, :3]
        viewmats[k, :3, 3] = -viewmats[k, :3, :3] @ (center + spacing * rng.uniform(-noise, noise, 3))
    return viewmats


def _exposed(views: Views, stops: float, folder: Path) -> Views:
    """Training photos brighter or darker; held-out ones as they are, so that a scene is measured at one exposure."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn = np.random.default_rng(0).uniform(-stops, stops, len(views.names))
    images = list(views.images)
    for i in np.flatnonzero(~views.is_test):
        image = views.read(i)[0] * 2.0 ** (drawn[i] / GAMMA)
        path = (folder / f"{i:06d}.png").resolve()
        cv2.imwrite(str(path), np.clip(image + 0.5, 0, 255).astype(np.uint8)[..., ::-1])
        images[i] = str(path)
    return dataclasses.replace(views, images=tuple(images))
