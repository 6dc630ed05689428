"""OUTPUT/colmap: the undistorted photos with a COLMAP model that any trainer opens, and the cameras as photographed."""

import dataclasses
import shutil
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path, PurePosixPath

import cv2
import numpy as np

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.colmap import write_model
from graphgs.scene.origin import AT_ZERO, Origin, moved_back
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.views import Views
from graphgs.sources.photos import Photos

JPEG = [cv2.IMWRITE_JPEG_QUALITY, 98, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
TO_CONVERGENCE = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)


def write_colmap(
    folder: Path,
    views: Views,
    reconstruction: Reconstruction,
    photos: Photos
    | None = None,  # what the views were made from; None leaves original/ at the size they were decoded to
    *,
    origin: Origin = AT_ZERO,  # of the world, in the frame that original/ is written in
    threads: int = 1,
    reporter: Reporter | None = None,
) -> None:
    """Write images/ + sparse/0 (undistorted, PINHOLE) and original/ (the estimated cameras with their distortion, for
    the upright photos at their own size). `folder` is replaced as a whole.

    sparse/0 is in the world's frame, near zero: other trainers are as single in their precision as ours. original/ is
    in the frame that given poses came in.

    A photo keeps its name when it is a .jpg, .jpeg or .png; to any other ".png" is appended. Raises DataError when a
    view is not part of the reconstruction.
    """
    partial = folder.with_name(folder.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    names = file_names(views.names)
    decoded = () if photos is None else photos.photos
    original_sizes = {photo.name: (photo.original_width, photo.original_height) for photo in decoded}
    write_model(undistorted_model(views, reconstruction), partial / "sparse" / "0", names=names)
    write_model(moved_back(original_model(reconstruction, original_sizes), origin), partial / "original")
    _write_images(partial / "images", names, views, threads, reporter or Reporter())
    if folder.exists():
        shutil.rmtree(folder)
    partial.rename(folder)


def file_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """The file below images/ for every photo name, unique."""
    taken, files = set(names), []
    for name in names:
        path = PurePosixPath(name)
        if path.is_absolute() or ".." in path.parts:
            raise DataError(f"{name!a}: not a path inside the photo folder", hint="rename the photo and run again")
        file = name
        if not name.lower().endswith((".jpg", ".jpeg", ".png")):
            file += ".png"
            while file in taken:
                file += ".png"
            taken.add(file)
        files.append(file)
    return tuple(files)


def undistorted_model(views: Views, reconstruction: Reconstruction) -> Reconstruction:
    """The model of the views: pinhole cameras and poses of theirs, the points with the tracks that lie in them."""
    index = {name: i for i, name in enumerate(reconstruction.names)}
    lost = [name for name in views.names if name not in index]
    if lost:
        raise DataError(f"{len(lost)} views are not in the reconstruction: {', '.join(lost[:3])}")
    cameras: dict[Camera, int] = {}
    camera_ids = []
    for (width, height), K in zip(views.sizes, views.Ks, strict=True):
        camera = Camera.pinhole(int(width), int(height), K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        camera_ids.append(cameras.setdefault(camera, len(cameras)))

    view_of = np.full(len(reconstruction.names), -1)  # image of the reconstruction -> view
    view_of[[index[name] for name in views.names]] = np.arange(len(views.names))
    view = view_of[reconstruction.track_images]  # [T]
    xy = np.zeros_like(reconstruction.track_xy)
    by_image = np.argsort(reconstruction.track_images, kind="stable")
    ends = np.cumsum(np.bincount(reconstruction.track_images, minlength=len(reconstruction.names)))
    for i, seen in enumerate(np.split(by_image, ends[:-1])):
        if view_of[i] >= 0 and len(seen):
            K = views.Ks[view_of[i]]
            xy[seen] = undistort_points(reconstruction.track_xy[seen], reconstruction.camera_of(i), K)

    point = np.repeat(np.arange(len(reconstruction.points)), reconstruction.track_lengths)  # [T]
    lengths = np.bincount(point[view >= 0], minlength=len(reconstruction.points))
    kept = (lengths > 0) | (reconstruction.track_lengths == 0)  # not those that lost all who saw them
    model = Reconstruction(
        cameras=tuple(cameras),
        names=views.names,
        camera_ids=np.array(camera_ids, dtype=np.int64),
        rotations=views.viewmats[:, :3, :3],
        translations=views.viewmats[:, :3, 3],
        points=reconstruction.points[kept],
        colors=reconstruction.colors[kept],
        errors=reconstruction.errors[kept],
        track_offsets=np.concatenate([[0], np.cumsum(lengths[kept])]).astype(np.int64),
        track_images=view[view >= 0].astype(np.int32),
        track_xy=xy[view >= 0],
    )
    return dataclasses.replace(model, errors=_reprojection_errors(model, views.Ks))


def undistort_points(
    xy: np.ndarray,  # [M, 2] px in the distorted photo
    camera: Camera,
    K: np.ndarray,  # [3, 3] px, of the undistorted image
) -> np.ndarray:
    """[M, 2] px where the same rays meet the undistorted image. Pixel centres lie at +0.5 in both: K takes them to rays
    and back, and the distortion formulas know rays only."""
    source, options = xy.reshape(-1, 1, 2).astype(np.float64), {"R": np.eye(3), "P": K, "criteria": TO_CONVERGENCE}
    if camera.is_fisheye:
        return cv2.fisheye.undistortPoints(source, camera.K, camera.distortion, **options).reshape(-1, 2)
    undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)  # OpenCV 4 took criteria only there
    distortion = camera.distortion if len(camera.distortion) else np.zeros(4)
    return undistort(source, camera.K, distortion, **options).reshape(-1, 2)


def original_model(reconstruction: Reconstruction, sizes: Mapping[str, tuple[int, int]]) -> Reconstruction:
    """The reconstruction as it is, its pixels those of the photos at the given sizes."""
    cameras: dict[Camera, int] = {}
    camera_ids, factors = [], np.ones((len(reconstruction.names), 2))
    for i, name in enumerate(reconstruction.names):
        camera = reconstruction.camera_of(i)
        width, height = sizes.get(name, (camera.width, camera.height))
        factors[i] = width / camera.width, height / camera.height
        scaled = camera.scaled_to(int(width), int(height))
        camera_ids.append(cameras.setdefault(scaled, len(cameras)))
    point = np.repeat(np.arange(len(reconstruction.points)), reconstruction.track_lengths)
    of_track = factors.mean(1)[reconstruction.track_images]
    lengths = np.maximum(reconstruction.track_lengths, 1)
    growth = np.bincount(point, weights=of_track, minlength=len(reconstruction.points)) / lengths
    return dataclasses.replace(
        reconstruction,
        cameras=tuple(cameras),
        camera_ids=np.array(camera_ids, dtype=np.int64),
        errors=np.where(reconstruction.errors < 0, reconstruction.errors, reconstruction.errors * growth),
        track_xy=reconstruction.track_xy * factors[reconstruction.track_images],
    )


def _reprojection_errors(model: Reconstruction, Ks: np.ndarray) -> np.ndarray:
    """[P] mean distance of a point's projections from its observations, px of the views; -1 (COLMAP's "not computed")
    without a track."""
    point = np.repeat(np.arange(len(model.points)), model.track_lengths)
    image = model.track_images
    seen = np.einsum("tij,tj->ti", model.rotations[image], model.points[point]) + model.translations[image]
    projected = np.einsum("tij,tj->ti", Ks[image], seen)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.linalg.norm(projected[:, :2] / projected[:, 2:] - model.track_xy, axis=1)
    total = np.bincount(point, weights=distance, minlength=len(model.points))
    return np.where(model.track_lengths > 0, total / np.maximum(model.track_lengths, 1), -1.0)


def _write_images(folder: Path, names: tuple[str, ...], views: Views, threads: int, reporter: Reporter) -> None:
    def write(i: int) -> str:
        path = folder / names[i]
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix.lower() == ".png":
            shutil.copyfile(views.folder / views.images[i], path)
        else:
            image, _ = views.read(i)
            path.write_bytes(cv2.imencode(".jpg", image[..., ::-1], JPEG)[1])
        return names[i]

    with ThreadPoolExecutor(threads, thread_name_prefix="colmap-images") as pool:
        jobs = [pool.submit(write, i) for i in range(len(names))]
        for done, job in enumerate(as_completed(jobs), 1):
            reporter.progress(done, len(jobs), job.result())
