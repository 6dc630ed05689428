"""A tiny scene rendered by the project's own rasterizer: posed views on disk, their graph and initial points."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from graphgs.graph import CameraGraph
from graphgs.points import DenseCloud, PrunedPoints
from graphgs.rendering.splats import Splats, render
from graphgs.scene.views import Views

WIDTH, HEIGHT, COUNT, CAMERAS = 40, 28, 60, 9


@dataclass(frozen=True)
class TinyScene:
    truth: Splats
    views: Views
    graph: CameraGraph
    points: PrunedPoints


def tiny_scene(folder: Path, *, seed: int = 0) -> TinyScene:
    """Blobs in a box seen by cameras on an arc; every fourth view is held out. Initial points are off by a bit."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-0.6, 0.6, (COUNT, 3)).astype(np.float32)
    colors = rng.uniform(0.1, 0.9, (COUNT, 3)).astype(np.float32)
    start = PrunedPoints(
        positions=positions + rng.normal(0, 0.02, positions.shape).astype(np.float32),
        colors=np.full_like(colors, 0.5),
        scales=np.full(COUNT, 0.12, np.float32),
        representative=np.arange(COUNT),
        coverage=0.0,
    )
    exact = PrunedPoints(positions, colors, start.scales, start.representative, 0.0)
    truth = Splats.from_points(exact, initial_opacity=0.9)
    K = np.array([[WIDTH, 0.0, WIDTH / 2], [0.0, WIDTH, HEIGHT / 2], [0.0, 0.0, 1.0]])
    viewmats = np.stack([_look_at_origin(angle) for angle in np.linspace(-0.5, 0.5, CAMERAS)])
    names = tuple(f"{k:02d}.png" for k in range(CAMERAS))
    for name, viewmat in zip(names, viewmats, strict=True):
        with torch.no_grad():
            image = render(truth, K, viewmat, WIDTH, HEIGHT, sh_degree=0).colors[0].clamp(0, 1).numpy()
        cv2.imwrite(str(folder / name), (255 * image[..., ::-1]).round().astype(np.uint8))
    is_test = np.arange(CAMERAS) % 4 == 0
    rotations = viewmats[:, :3, :3]
    centers = -np.einsum("nji,nj->ni", rotations, viewmats[:, :3, 3])
    edges = np.array([(i, j) for i in range(CAMERAS) for j in range(i + 1, min(i + 3, CAMERAS))])
    return TinyScene(
        truth=truth,
        views=Views(
            folder=folder,
            names=names,
            images=names,
            masks=(None,) * CAMERAS,
            sizes=np.tile([WIDTH, HEIGHT], (CAMERAS, 1)),
            Ks=np.tile(K, (CAMERAS, 1, 1)),
            viewmats=viewmats,
            is_test=is_test,
        ),
        graph=CameraGraph(names, rotations, centers, edges, np.full(len(edges), 50), is_test),
        points=start,
    )


def _look_at_origin(angle: float) -> np.ndarray:
    """[4, 4] world-to-camera at distance 2.5, turned about y."""
    c, s = np.cos(angle), np.sin(angle)
    viewmat = np.eye(4)
    viewmat[:3, :3] = [[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]
    viewmat[2, 3] = 2.5
    return viewmat


def tiny_surfaces(scene: TinyScene) -> DenseCloud:
    """The blobs' centres as surfaces, as every view has found them, held-out ones too."""
    count, views = len(scene.truth), len(scene.views.names)
    positions = np.tile(scene.truth.means.numpy().astype(np.float64), (views, 1))
    colors = np.full((len(positions), 3), 128, np.uint8)
    rows = len(positions)
    return DenseCloud(positions, colors, np.full(rows, 3), np.repeat(np.arange(views), count), np.ones(rows))
