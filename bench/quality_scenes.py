"""Prepared inputs of the quality benchmark: posed photos, their graph and their points, found once and kept small.

A scene holds photos at the training size (JPEG, shared by all scenes of a set), a reconstruction without the image
points and their errors, which the octree then takes for exact, and the camera graph. So training can start from it
elsewhere, without estimating poses again. Undistorted views and the dense cloud are remade from it where it is used.
"""

import dataclasses
import hashlib
import json
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from graphgs.graph import CameraGraph
from graphgs.graph.build import build_camera_graph
from graphgs.points import DenseCloud, PointsConfig, PrunedPoints, dense_cloud, keep_all, prune_octree
from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.colmap import read_model
from graphgs.scene.covisibility import shared_points
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import align
from graphgs.scene.views import Views
from graphgs.stages import DENSE
from tests.support.disturbed_poses import noisy

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"  # real photo sets; they are not part of the project
JPEG_QUALITY = 93  # without chroma subsampling: 43 dB, far above what is measured
JPEG = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
OCTREE_SHARE = 0.4  # of the points, where the octree is measured

# Frozen. street: 26 stops, 2.8 m apart, which is every 4th frame of the default drive, by three cameras; drive: the
# default, 36 frames 0.7 m apart by one camera.
SYNTHETIC = {
    "street": {"frames": 26, "cameras": 3, "spacing": 2.8, "width": 480, "height": 270, "seed": 0},
    "drive": {"frames": 36, "cameras": 1, "spacing": 0.7, "width": 480, "height": 270, "seed": 0},
}


@dataclass(frozen=True)
class Recipe:
    """How a scene is made: a set's photos, and what finds their poses."""

    photos: str  # a folder below the data, or one of SYNTHETIC
    max_side: int  # [px] of the training images
    poses: str = "own"  # own, exact (the truth), coarse (the first reconstruction alone)
    settings: tuple[str, ...] = ()  # stage.field=value
    prior_noise: float = 0.0  # pairs are chosen by the set's own poses, disturbed by up to so many rad and spacings


def _variants(name: str, photos: str, max_side: int, loose: bool) -> dict[str, Recipe]:
    """The same photos with poses that lack a part of the structure estimation."""
    paper = "paper-loose" if loose else "paper-strict"
    return {
        f"{name}+coarse": Recipe(photos, max_side, "coarse"),
        f"{name}+unfiltered": Recipe(photos, max_side, settings=("pairing.filter=none",)),
        f"{name}+sequential": Recipe(photos, max_side, settings=("pairing.pairs=sequential",)),
        f"{name}+paper": Recipe(photos, max_side, settings=("pairing.pairs=paper", f"pairing.filter={paper}")),
    }


RECIPES = {
    "fox": Recipe("fox/images", 480),
    "street-own": Recipe("street", 480),
    "street": Recipe("street", 480, "exact"),
    "castle": Recipe("castle/images", 506),
    "kitti_street": Recipe("kitti_street/images", 401),
    "ochota_aerial": Recipe("ochota_aerial/images", 480),
    "drive": Recipe("drive", 480, "exact"),
    "fox+noisy-prior": Recipe("fox/images", 480, prior_noise=0.3),
    **_variants("fox", "fox/images", 480, loose=False),
    **_variants("street-own", "street", 480, loose=True),
}
SETS = tuple(name for name in RECIPES if "+" not in name)


@dataclass(frozen=True)
class Scene:
    """What training and its judgement need of one set of photos."""

    name: str
    views: Views
    graph: CameraGraph
    model: Reconstruction  # points and tracks, without image points
    points: dict[str, PrunedPoints]  # "octree": the reconstruction's at OCTREE_SHARE
    dense: DenseCloud
    dense_s: float  # CPU seconds it took to find
    true_depths: dict[str, np.ndarray] | None = None  # [H, W] camera z by held-out view, scene units, 0 = none


def prepare(names: list[str], cache: Path, data: Path, *, threads: int) -> None:
    """Make the scenes that are not there yet. A set whose photos are missing is skipped with a note."""
    for name in names:
        recipe = RECIPES[name]
        if _folder(cache, name).exists():
            print(f"{name}: prepared")
        elif recipe.photos not in SYNTHETIC and not (data / recipe.photos).is_dir():
            print(f"{name}: skipped, its photos are not there ({data / recipe.photos})")
        else:
            print(f"{name}: preparing", flush=True)
            _prepare(name, recipe, cache, data, threads)


def prepared(cache: Path) -> list[str]:
    return [name for name in RECIPES if _folder(cache, name).is_dir()]


def load_scene(cache: Path, name: str, *, threads: int = 1) -> Scene:
    """A prepared scene; its undistorted views and its dense cloud are made at the first call."""
    from graphgs.sources import Photos
    from graphgs.structure.config import StructureConfig
    from graphgs.structure.undistort import undistort

    folder, made = _folder(cache, name), _root(cache) / "views" / f"{name}-{scene_digest(cache, name)}"
    header = json.loads((folder / "scene.json").read_text())
    model, points = _read_arrays(folder / "scene.npz", header)
    photos = Photos.load(_root(cache) / "photos" / header["photos"])
    if not made.exists():
        partial = made.with_name(f"{made.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        config = StructureConfig(max_side=header["max_side"])
        undistort(config, photos, model, partial, reporter=Reporter(), threads=threads).save(partial)
        partial.rename(made)
    depths = _true_depths(_root(cache) / "photos" / header["photos"] / "depth.npz", model, header)
    views = Views.load(made)
    settings = {k: v for k, v in dataclasses.asdict(PointsConfig()).items() if k.startswith("dense")}
    kind = hashlib.sha256(json.dumps([DENSE.version, settings]).encode()).hexdigest()[:8]
    dense, seconds = _dense(made.with_name(f"{made.name}-dense-{kind}"), model, views, threads)
    return Scene(name, views, CameraGraph.load(folder / "graph.json"), model, points, dense, seconds, depths)


def _dense(folder: Path, model: Reconstruction, views: Views, threads: int) -> tuple[DenseCloud, float]:
    """The dense cloud as the pipeline makes it, and the CPU seconds that took."""
    took = folder / "seconds.json"
    if not took.is_file():
        start = time.process_time()
        cloud = dense_cloud(PointsConfig(), model, views, reporter=Reporter(), threads=threads)
        seconds = time.process_time() - start
        cloud.save(folder)
        took.write_text(json.dumps(seconds))
    return DenseCloud.load(folder), json.loads(took.read_text())


def scene_digest(cache: Path, name: str) -> str:
    """Of a prepared scene's poses, graph and points: another scene, other measurements."""
    content = hashlib.sha256()
    for path in sorted(_folder(cache, name).glob("*")):
        content.update(path.read_bytes())
    return content.hexdigest()[:12]


def _root(cache: Path) -> Path:
    return cache / "quality"


def _folder(cache: Path, name: str) -> Path:
    return _root(cache) / "scenes" / name


def _prepare(name: str, recipe: Recipe, cache: Path, data: Path, threads: int) -> None:
    from graphgs.pipeline import PHOTOS
    from graphgs.sources import Photos
    from graphgs.structure.colors import colored
    from graphgs.workspace import find_stage

    synthetic = recipe.photos in SYNTHETIC
    source = _synthetic(cache, recipe.photos) if synthetic else data / recipe.photos
    base = "street-own" if recipe.photos == "street" else name.split("+")[0]
    work = _root(cache) / "work" / (name if recipe.poses == "own" else base)
    if not work.exists() and (_root(cache) / "work" / base).exists():
        shutil.copytree(_root(cache) / "work" / base, work)  # features and coarse poses are the same
    prior = f"poses={_noisy_poses(cache, base, recipe.prior_noise)}" if recipe.prior_noise else "auto"
    _pose(source, work, recipe, prior, threads)
    photos = Photos.load(find_stage(work, PHOTOS).folder)
    model, edges, inliers = _reconstruction(recipe, source, work)
    if recipe.poses == "coarse":  # its points have no colours yet
        model = colored(model, photos, threads=threads)
    is_test = dict(zip(photos.names, photos.is_test, strict=True))
    graph = build_camera_graph(model, np.array([is_test[photo] for photo in model.names]), edges, inliers)
    target = max(1, round(OCTREE_SHARE * len(model.points)))
    points = {
        "octree": prune_octree(
            model.points, model.colors, errors=np.maximum(model.errors, 0.0), track_lengths=model.track_lengths,
            target=target, threads=threads,
        )
    }  # fmt: skip
    kept = recipe.photos if synthetic else base
    _write_photos(photos, _root(cache) / "photos" / kept, recipe.max_side)
    scale = 1.0
    if synthetic:
        _write_depths(photos, source.parent / "truth", _root(cache) / "photos" / kept)
        truth = read_model(source.parent / "truth")
        centers = dict(zip(truth.names, truth.centers, strict=True))
        scale = align(model.centers, np.array([centers[photo] for photo in model.names])).scale
    target = _folder(cache, name)
    partial = target.with_name(f"{name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    graph.save(partial / "graph.json")
    header = {"photos": kept, "max_side": recipe.max_side, "names": model.names, "true_scale": scale}
    header["cameras"] = [dataclasses.asdict(camera) for camera in model.cameras]
    (partial / "scene.json").write_text(json.dumps(header))
    _write_arrays(partial / "scene.npz", model, points)
    partial.rename(target)


def _reconstruction(recipe: Recipe, source: Path, work: Path) -> tuple[Reconstruction, np.ndarray, np.ndarray]:
    """(reconstruction, pairs [E, 2], their strength [E]) by the recipe."""
    from graphgs.pipeline import COARSE, MAPPING
    from graphgs.structure.prior import Prior
    from graphgs.structure.result import Structure
    from graphgs.workspace import find_stage

    if recipe.poses == "own":
        structure = Structure.load(find_stage(work, MAPPING).folder)
        return structure.reconstruction, structure.edges, structure.inliers
    if recipe.poses == "exact":
        model = read_model(source.parent / "truth")
    else:
        model = Prior.load(find_stage(work, COARSE).folder).reconstruction
    return model, *_covisible(model)


def _synthetic(cache: Path, name: str) -> Path:
    from graphgs.commands import synthesize
    from graphgs.synth.street import StreetConfig

    folder = _root(cache) / "work" / f"{name}-photos"
    synthesize("street", folder, StreetConfig(**SYNTHETIC[name]))
    return folder / "images"


def _noisy_poses(cache: Path, name: str, noise: float) -> Path:
    """A prepared scene's poses, disturbed, as KITTI writes them: a line per photo, so all must have been placed."""
    header = json.loads((_folder(cache, name) / "scene.json").read_text())
    model, _ = _read_arrays(_folder(cache, name) / "scene.npz", header)
    world_from_cam = np.linalg.inv(noisy(model.viewmats, noise))
    path = _root(cache) / "work" / f"{name}-noise-{noise:g}.txt"
    np.savetxt(path, world_from_cam[:, :3].reshape(-1, 12))
    return path


def _pose(source: Path, work: Path, recipe: Recipe, prior: str, threads: int) -> None:
    from graphgs.api import pose

    pose(
        source, work, preset="preview", max_side=recipe.max_side, threads=threads, allow_partial=True, prior=prior,
        settings_extra=recipe.settings,
    )  # fmt: skip


def _covisible(model: Reconstruction) -> tuple[np.ndarray, np.ndarray]:
    """(edges [E, 2], shared points [E]) of all pairs that see enough of the same."""
    shared = shared_points(model).tocoo()
    kept = (shared.row < shared.col) & (shared.data >= 15)  # COLMAP's least number of inliers
    return np.stack([shared.row[kept], shared.col[kept]], axis=1).astype(np.int64), shared.data[kept]


def _write_photos(photos, folder: Path, max_side: int) -> None:
    """The decoded photos at the training size, reduced as the pipeline does."""
    if (folder / "photos.json").is_file():
        return
    folder.mkdir(parents=True, exist_ok=True)
    kept = []
    for k, photo in enumerate(photos.photos):
        image = cv2.imread(str(photos.folder / photo.pixels), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        scale = min(1.0, max_side / max(image.shape[:2]))
        size = tuple(max(1, round(side * scale)) for side in image.shape[1::-1])
        if scale < 1.0:
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        grey = bool((image == image[..., :1]).all())
        cv2.imwrite(str(folder / f"{k:06d}.jpg"), image[..., 0] if grey else image, JPEG)
        kept.append(dataclasses.replace(photo, pixels=f"{k:06d}.jpg", width=size[0], height=size[1], mask=None))
    dataclasses.replace(photos, photos=tuple(kept), given=None, rigs=()).save(folder)


def _write_depths(photos, folder: Path, target: Path) -> None:
    """The depth images of the held-out photos."""
    depths = {}
    for name in np.array(photos.names)[photos.is_test]:
        with np.load(folder / "depth" / f"{Path(str(name)).with_suffix('')}.npz") as arrays:
            depths[str(name)] = arrays["depth"].astype(np.float16)  # to 0.05 %
    np.savez_compressed(target / "depth.npz", **depths)


def _true_depths(path: Path, model: Reconstruction, header: dict) -> dict[str, np.ndarray] | None:
    """The true depth images as the undistorted views see them, in the scene's own unit of length."""
    from graphgs.structure.undistort import undistortion

    if not path.is_file():
        return None
    result = {}
    with np.load(path) as arrays:
        for name in set(arrays.files) & set(model.names):
            depth = arrays[name].astype(np.float32)
            camera = model.camera_of(model.names.index(name)).scaled_to(depth.shape[1], depth.shape[0])
            plan = undistortion(camera)
            if plan.map_x is not None:
                depth = cv2.remap(depth, plan.map_x, plan.map_y, cv2.INTER_NEAREST)
            result[name] = depth / header["true_scale"]
    return result


def _write_arrays(path: Path, model: Reconstruction, points: dict[str, PrunedPoints]) -> None:
    """In the least precision that changes nothing that is measured."""
    arrays = {
        "camera_ids": model.camera_ids.astype(np.uint16), "rotations": model.rotations,
        "translations": model.translations, "points": model.points.astype(np.float32), "colors": model.colors,
        "track_lengths": model.track_lengths.astype(np.uint16), "track_images": model.track_images.astype(np.uint16),
    }  # fmt: skip
    for which, chosen in points.items():
        arrays |= {
            f"{which}_positions": chosen.positions.astype(np.float32), f"{which}_colors": chosen.colors,
            f"{which}_scales": chosen.scales.astype(np.float32),
        }  # fmt: skip
    np.savez_compressed(path, **arrays)


def _read_arrays(path: Path, header: dict) -> tuple[Reconstruction, dict[str, PrunedPoints]]:
    with np.load(path) as stored:
        arrays = dict(stored)
    cameras = tuple(Camera(c["model"], c["width"], c["height"], tuple(c["params"])) for c in header["cameras"])
    images = arrays["track_images"].astype(np.int32)
    model = Reconstruction(
        cameras, tuple(header["names"]), arrays["camera_ids"].astype(np.int64), arrays["rotations"],
        arrays["translations"], arrays["points"].astype(np.float64), arrays["colors"],
        np.zeros(len(arrays["points"])), np.r_[0, np.cumsum(arrays["track_lengths"], dtype=np.int64)], images,
        np.zeros((len(images), 2)),
    )  # fmt: skip
    points = {}
    for which in ("octree",):
        positions = arrays[f"{which}_positions"].astype(np.float64)
        points[which] = PrunedPoints(
            positions, arrays[f"{which}_colors"], arrays[f"{which}_scales"].astype(np.float64),
            np.zeros(0, np.int64), 0.0,
        )  # fmt: skip
    return model, points


def every_point(model: Reconstruction, rows: np.ndarray | None = None) -> PrunedPoints:
    """The reconstruction's points, or the chosen ones, as they are."""
    chosen = np.arange(len(model.points)) if rows is None else rows
    return keep_all(model.points[chosen], model.colors[chosen])
