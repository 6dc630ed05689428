"""A prepared scene as a case wants it: other points, fewer photos, disturbed poses or exposures. Drawn once: all seeds
of a case train on the same input."""

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from bench.quality_cases import Case
from bench.quality_scenes import OCTREE_SHARE, Scene, every_point
from graphgs.config import preset
from graphgs.graph import CameraGraph
from graphgs.points import DenseCloud, PrunedPoints, dense_cloud, initial_points, keep_all, prune_octree
from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.views import Views
from graphgs.synth.street import GAMMA
from tests.support.disturbed_poses import disturbed, noisy

PREVIEW = preset("preview")
WITHOUT_DENSE = ("sparse", "all", "octree", "random")  # initial points of the reconstruction alone
JOINED = 30_000  # reconstructed and dense points that the octree is compared on
DISTURBED_DEG, DISTURBED_SHIFT = 0.5, 0.01  # of a pose: turn, and shift in largest distances between cameras


@dataclass(frozen=True)
class Inputs:
    views: Views
    graph: CameraGraph
    points: PrunedPoints
    dense: DenseCloud
    dense_s: float  # CPU seconds that went into the points beside the reconstruction


def inputs_of(
    case: Case,
    scene: Scene,
    folder: Path,  # for altered photos
) -> Inputs:
    views, graph, model, dropped = scene.views, scene.graph, scene.model, np.zeros(len(scene.views.names), bool)
    if case.disturbed:
        moved = disturbed(views, rotation_deg=DISTURBED_DEG, shift=DISTURBED_SHIFT)
        views, graph = _with_poses(views, graph, moved)
    if case.noise:
        views, graph = _with_poses(views, graph, noisy(views.viewmats, case.noise))
    if case.exposure_stops:
        views = _exposed(views, case.exposure_stops, folder)
    if case.passers_by:
        views = _passed_by(views, case.passers_by, folder)
    if case.keep_every > 1:
        rows = _kept(views.is_test, case.keep_every)
        dropped = np.isin(np.arange(len(dropped)), rows, invert=True)
        model = _points_of(model, _seen_twice(model, rows[~views.is_test[rows]]))
    dense, seconds = _dense(case, scene, model, views, dropped)
    points = _points(case, scene, model, dense)
    if dropped.any():
        kept = np.flatnonzero(~dropped)
        views, graph, dense = _view_rows(views, kept), _graph_rows(graph, kept), dense.of_views(kept)
    return Inputs(views, graph, points, dense, seconds)


def _dense(
    case: Case, scene: Scene, model: Reconstruction, views: Views, dropped: np.ndarray
) -> tuple[DenseCloud, float]:
    """The dense cloud of a case, from the poses and photos that training is given, and the CPU seconds it took."""
    if case.points in WITHOUT_DENSE:
        return DenseCloud.empty(), 0.0
    if views is scene.views and not dropped.any():
        return scene.dense, scene.dense_s
    start = time.process_time()
    posed = dataclasses.replace(model, rotations=views.viewmats[:, :3, :3], translations=views.viewmats[:, :3, 3])
    usable = dataclasses.replace(views, is_test=views.is_test | dropped)
    dense = dense_cloud(PREVIEW.points, posed, usable, reporter=Reporter(), threads=1)
    return dense, time.process_time() - start


def _points(case: Case, scene: Scene, model: Reconstruction, dense: DenseCloud) -> PrunedPoints:
    """The initial points of a case."""
    if case.points == "all":
        return every_point(model)
    if case.points == "octree":
        return scene.points["octree"]
    if case.points == "random":
        return _drawn(every_point(model), len(scene.points["octree"].positions))
    config, max_splats = PREVIEW.points, case.training.get("max_splats", PREVIEW.training.max_splats)
    options = {"max_splats": max_splats, "reporter": Reporter(), "threads": 1}
    if case.points.startswith(("joined", "filled")):  # the octree is given reconstructed and dense points alike
        count = JOINED if case.points.startswith("joined") else max_splats
        every = initial_points(dataclasses.replace(config, mode="none", target=count), model, dense, **options)
        target = round(OCTREE_SHARE * len(every.positions))
        if case.points.endswith("octree"):
            return prune_octree(every.positions, every.colors, target=target, threads=1)
        return _drawn(every, target) if case.points.endswith("random") else every
    return initial_points(config, model, dense, **options)


def _drawn(points: PrunedPoints, count: int) -> PrunedPoints:
    rows = np.random.default_rng(0).choice(len(points.positions), min(count, len(points.positions)), replace=False)
    return keep_all(points.positions[rows], points.colors[rows])


def _points_of(model: Reconstruction, rows: np.ndarray) -> Reconstruction:
    """The reconstruction with only these points."""
    lengths = model.track_lengths
    kept = np.isin(np.repeat(np.arange(len(lengths)), lengths), rows)
    return dataclasses.replace(
        model, points=model.points[rows], colors=model.colors[rows], errors=model.errors[rows],
        track_offsets=np.r_[0, np.cumsum(lengths[rows])], track_images=model.track_images[kept],
        track_xy=model.track_xy[kept],
    )  # fmt: skip


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


def _exposed(views: Views, stops: float, folder: Path) -> Views:
    """Training photos brighter or darker; held-out ones as they are, so that a scene is measured at one exposure."""
    drawn = np.random.default_rng(0).uniform(-stops, stops, len(views.names))

    def exposed(image: np.ndarray, i: int) -> np.ndarray:
        return np.clip(image * 2.0 ** (drawn[i] / GAMMA) + 0.5, 0, 255).astype(np.uint8)

    return _altered(views, exposed, folder)


def _passed_by(views: Views, share: float, folder: Path) -> Views:
    """Training photos with somebody in front: an upright ellipse of one noisy colour, another one in each photo, that
    covers `share` of it; held-out photos as they are."""

    def passed_by(image: np.ndarray, i: int) -> np.ndarray:
        rng = np.random.default_rng(i)
        height, width = image.shape[:2]
        tall = np.sqrt(share * height * width * 2.5 / np.pi)  # half the height: 2.5 times as tall as wide
        x, y = rng.uniform(0, width), rng.uniform(0.4, 0.8) * height
        columns, rows = np.meshgrid(np.arange(width), np.arange(height))
        inside = ((columns - x) / (tall / 2.5)) ** 2 + ((rows - y) / tall) ** 2 < 1
        colors = rng.integers(0, 256, 3) + rng.normal(0, 12, image.shape)
        return np.where(inside[..., None], np.clip(colors, 0, 255), image).astype(np.uint8)

    return _altered(views, passed_by, folder)


def _altered(views: Views, change: Callable[[np.ndarray, int], np.ndarray], folder: Path) -> Views:
    folder.mkdir(parents=True, exist_ok=True)
    images = list(views.images)
    for i in np.flatnonzero(~views.is_test):
        path = (folder / f"{i:06d}.png").resolve()
        cv2.imwrite(str(path), np.ascontiguousarray(change(views.read(i)[0], i)[..., ::-1]))
        images[i] = str(path)
    return dataclasses.replace(views, images=tuple(images))
