"""The camera graph from above, as SVG: who was placed where, looks which way, and is tied to whom."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from graphgs.evaluation.report import numbers
from graphgs.evaluation.report.data import CameraFigures
from graphgs.evaluation.report.html import Markup, element

WIDTH, MIN_HEIGHT, MAX_HEIGHT, MARGIN, FOOT = 760, 180, 540, 30, 22
EDGE_BINS = 5
LOST_REACH = 22.0  # SVG units from a camera to a photo that could not be placed


@dataclass(frozen=True)
class Plane:
    """Two world directions that become right and down of the picture."""

    right: np.ndarray  # [3]
    down: np.ndarray  # [3]
    seen: str  # where the onlooker stands, in words


_NORTH_UP = Plane(np.array([1.0, 0, 0]), np.array([0.0, -1, 0]), "from above, north up")


def viewing_plane(centers: np.ndarray, rotations: np.ndarray) -> Plane:
    """The principal plane of the camera centres, seen from the side where the cameras' up points (never mirrored).

    A track so straight that its sideways spread says nothing about the ground is shown in the plane across the
    cameras' up.
    A wall of cameras has its normal along the view instead: it is seen from behind the cameras.
    """
    up = _unit(-rotations[:, 1].mean(0))  # rows of R are the camera's axes in the world; y points down
    forward = _unit(rotations[:, 2].mean(0))
    spread = centers - centers.mean(0)
    _, sizes, axes = np.linalg.svd(np.vstack([spread, np.zeros((3, 3))]), full_matrices=False)
    if sizes[1] < 0.1 * sizes[0]:
        across = up - (up @ axes[0]) * axes[0]
        normal = _unit(across) if np.linalg.norm(across) > 0.2 else axes[2]
    elif sizes[0] > 0:
        normal = axes[2]
    else:
        normal = up
    if abs(normal @ up) < abs(normal @ forward):
        normal = -normal if normal @ forward > 0 else normal
        down = _unit(-(up - (up @ normal) * normal))
        return Plane(np.cross(normal, down), down, "from behind the cameras")
    normal = normal if normal @ up >= 0 else -normal
    right = axes[0] - (axes[0] @ normal) * normal
    if np.linalg.norm(right) < 1e-9:
        right = np.eye(3)[np.argmin(np.abs(normal))]
        right = right - (right @ normal) * normal
    right = _unit(right)
    if right[np.argmax(np.abs(right))] < 0:  # the sign of a principal axis is arbitrary: fix it
        right = -right
    return Plane(right, np.cross(right, normal), "from above")


@dataclass(frozen=True)
class CameraMap:
    """The picture, and what its legend has to say."""

    svg: Markup
    edge_classes: list[tuple[str, str]]  # (CSS class, range of inliers), weakest first
    seen: str  # where the onlooker stands
    bar: float  # length of the scale bar, world units


def camera_map(cameras: CameraFigures) -> CameraMap:
    """Equal scale on both axes; at least one camera."""
    plane = _NORTH_UP if cameras.compass else viewing_plane(cameras.centers, cameras.rotations)
    basis = np.stack([plane.right, plane.down], axis=1)
    flat = (cameras.centers - cameras.centers.mean(0)) @ basis
    low, high = flat.min(0), flat.max(0)
    extent = np.maximum(high - low, 1e-12)
    room = np.array([WIDTH - 2 * MARGIN, MAX_HEIGHT - 2 * MARGIN - FOOT])
    scale = float((room / extent).min()) if (high - low).max() > 1e-9 else 1.0
    height = float(np.clip((high - low)[1] * scale + 2 * MARGIN + FOOT, MIN_HEIGHT, MAX_HEIGHT))
    xy = (flat - (low + high) / 2) * scale + np.array([WIDTH / 2, (height - FOOT) / 2])

    edge_paths, legend = _edges(cameras, xy)
    bar = numbers.nice_step(WIDTH / scale, count=8)
    y = round(height - 9, 1)
    ruler = f"M{MARGIN} {y - 5}V{y}H{MARGIN + bar * scale:.1f}V{y - 5}"
    svg = element(
        "svg",
        edge_paths,
        _objections(cameras, xy),
        _beside(cameras, xy),
        _cameras(cameras, xy, cameras.rotations[:, 2] @ basis),
        element("path", d=ruler, class_="ruler"),
        viewBox=f"0 0 {WIDTH} {height:.0f}",
        role="img",
        aria_label=f"{len(cameras.names)} cameras and {len(cameras.edges)} verified pairs, seen {plane.seen}",
        class_="map",
    )
    return CameraMap(svg, legend, plane.seen, bar)


def _edges(cameras: CameraFigures, xy: np.ndarray) -> tuple[list[Markup], list[tuple[str, str]]]:
    """One path per class of inlier counts, strong edges on top."""
    if not len(cameras.edges):
        return [], []
    inliers = np.asarray(cameras.inliers)
    limits = np.unique([_two_digits(q) for q in np.quantile(inliers, np.linspace(0, 1, EDGE_BINS + 1)[1:-1])])
    klass = np.searchsorted(limits, inliers, side="right")
    crowd = "many" if len(inliers) > 1500 else "few"
    paths, legend = [], []
    for k in range(len(limits) + 1):
        chosen = cameras.edges[klass == k]
        if not len(chosen):
            continue
        shade = f"e{round(k * (EDGE_BINS - 1) / max(len(limits), 1))}"
        a, b = xy[chosen[:, 0]], xy[chosen[:, 1]]
        d = "".join(f"M{p[0]:.1f} {p[1]:.1f}L{q[0]:.1f} {q[1]:.1f}" for p, q in zip(a, b, strict=True))
        paths.append(element("path", d=d, class_=f"edge {shade} {crowd}"))
        least, most = int(inliers[klass == k].min()), int(inliers[klass == k].max())
        legend.append((shade, numbers.count(least) if least == most else f"{least:,}–{most:,}"))
    return paths, legend


def _objections(cameras: CameraFigures, xy: np.ndarray) -> Markup | None:
    """Pairs that contradict the poses."""
    if cameras.objections is None or not len(cameras.objections):
        return None
    ends = zip(xy[cameras.objections[:, 0]], xy[cameras.objections[:, 1]], strict=True)
    d = "".join(f"M{p[0]:.1f} {p[1]:.1f}L{q[0]:.1f} {q[1]:.1f}" for p, q in ends)
    return element("path", element("title", "matched, but not as the poses have it"), d=d, class_="objection")


def _beside(cameras: CameraFigures, xy: np.ndarray) -> list[Markup]:
    """Photos without a pose: a red cross on a dashed line, outwards from the camera that each shares most with."""
    if cameras.beside is None:
        return []
    middle, taken, marks = xy.mean(0), {}, []
    for name, k in zip(cameras.unregistered, cameras.beside, strict=True):
        if k < 0:
            continue
        turn = taken.get(int(k), 0)
        taken[int(k)] = turn + 1
        away = xy[k] - middle
        angle = np.arctan2(away[1], away[0]) + 0.5 * ((turn + 1) // 2) * (-1) ** turn
        x, y = xy[k] + LOST_REACH * np.array([np.cos(angle), np.sin(angle)])
        line = element("path", d=f"M{xy[k][0]:.1f} {xy[k][1]:.1f}L{x:.1f} {y:.1f}", class_="lost-line")
        cross = f"M{x - 4:.1f} {y - 4:.1f}l8 8m0 -8l-8 8"
        title = element("title", f"{name}: not placed; shares most with {cameras.names[k]}")
        marks += [line, element("path", title, d=cross, class_="lost")]
    return marks


def _cameras(cameras: CameraFigures, xy: np.ndarray, directions: np.ndarray) -> list[Markup]:
    """Every camera: a tick along its view, a dot sized by importance. Smaller where they crowd; test views on top."""
    count = len(xy)
    small = float(np.clip(_spacing(xy) / 12.0, 0.35, 1.0))
    importance = np.zeros(count) if cameras.importance is None else np.asarray(cameras.importance, dtype=float)
    share = importance / importance.max() if count and importance.max() > 0 else np.zeros(count)
    degree = np.bincount(cameras.edges.ravel(), minlength=count) if len(cameras.edges) else np.zeros(count, int)
    marks = []
    for test in (False, True):
        kind = "test" if test else "train"
        chosen = np.flatnonzero(cameras.is_test == test)
        tips = xy[chosen] + directions[chosen] * 15.0 * small
        starts = zip(xy[chosen], tips, strict=True)
        ticks = "".join(f"M{p[0]:.1f} {p[1]:.1f}L{q[0]:.1f} {q[1]:.1f}" for p, q in starts)
        marks.append(element("path", d=ticks, class_=f"tick-{kind}") if ticks else None)
        for i in chosen:
            title = f"{cameras.names[i]}: {degree[i]} pairs"
            if cameras.importance is not None:
                title += f", importance {share[i]:.2f}"
            title += ", test view" if test else ""
            marks.append(_camera(xy[i], (3.2 + 2.8 * share[i]) * small, test, title))
    return marks


def _camera(at: np.ndarray, radius: float, test: bool, title: str) -> Markup:
    px, py = at
    if not test:
        attributes = {"cx": f"{px:.1f}", "cy": f"{py:.1f}", "r": f"{radius:.1f}"}
        return element("circle", element("title", title), class_="camera", **attributes)
    r = radius * 1.5
    d = f"M{px:.1f} {py - r:.1f}L{px + r:.1f} {py:.1f}L{px:.1f} {py + r:.1f}L{px - r:.1f} {py:.1f}Z"
    return element("path", element("title", title), d=d, class_="camera test")


def _spacing(xy: np.ndarray) -> float:
    """Median distance of a camera to its nearest neighbour in the picture, SVG units."""
    if len(xy) < 2:
        return float(WIDTH)
    return float(np.median(cKDTree(xy).query(xy, k=2)[0][:, 1]))


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector)
    return vector / length if length > 1e-12 else np.array([0.0, 0.0, 1.0])


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")
