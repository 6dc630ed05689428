"""Between plain values and COLMAP's objects."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction

Progress = Callable[[int, int], None]


def to_camera(camera_id: int, fields: dict) -> pycolmap.Camera:
    camera = pycolmap.Camera(
        camera_id=camera_id,
        model=fields["model"],
        width=fields["width"],
        height=fields["height"],
        params=list(fields["params"]),
    )
    camera.has_prior_focal_length = fields["known"]
    return camera


def set_intrinsics(camera: pycolmap.Camera, source: Camera) -> None:
    camera.model = getattr(pycolmap.CameraModelId, source.model)
    camera.width, camera.height, camera.params = source.width, source.height, list(source.params)


def adjustment(step: dict, refine: list[str], threads: int) -> pycolmap.BundleAdjustmentOptions:
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    options.refine_rig_from_world = "poses" in refine
    options.refine_focal_length = "focal" in refine
    options.refine_extra_params = "distortion" in refine
    options.refine_principal_point = "principal_point" in refine
    options.ceres.loss_function_type = getattr(pycolmap.LossFunctionType, step["loss"])
    options.ceres.loss_function_scale = step["loss_scale_px"]
    options.ceres.solver_options.num_threads = threads
    options.ceres.solver_options.max_num_iterations = 100
    options.ceres.solver_options.function_tolerance = step["tolerance"]
    return options


def save(model: pycolmap.Reconstruction, out: str) -> dict:
    """The model in COLMAP's format (to go on from) and as a Reconstruction, in one folder that appears at once."""
    partial, final = Path(out + ".partial"), Path(out)
    shutil.rmtree(partial, ignore_errors=True)
    (partial / "colmap").mkdir(parents=True)
    model.write_binary(partial / "colmap")
    _reconstruction(model).save(partial)
    shutil.rmtree(final, ignore_errors=True)
    partial.rename(final)
    return {"registered": model.num_reg_images()}


def _reconstruction(model: pycolmap.Reconstruction) -> Reconstruction:
    """Plain arrays, in the order of ids. Names are pixel files."""
    image_ids = sorted(model.reg_image_ids())
    images = [model.image(i) for i in image_ids]
    camera_ids = sorted({image.camera_id for image in images})
    poses = [image.cam_from_world() for image in images]
    row = {image_id: k for k, image_id in enumerate(image_ids)}
    pixels = {image.image_id: np.array([p.xy for p in image.points2D]).reshape(-1, 2) for image in images}
    point_ids = sorted(model.point3D_ids())
    points = [model.point3D(p) for p in point_ids]
    tracks = [sorted((e.image_id, e.point2D_idx) for e in p.track.elements) for p in points]
    observations = [pair for track in tracks for pair in track]
    return Reconstruction(
        cameras=tuple(_plain_camera(model.camera(c)) for c in camera_ids),
        names=tuple(image.name for image in images),
        camera_ids=np.array([camera_ids.index(image.camera_id) for image in images], dtype=np.int64),
        rotations=np.array([p.rotation.matrix() for p in poses]).reshape(-1, 3, 3),
        translations=np.array([p.translation for p in poses]).reshape(-1, 3),
        points=np.array([p.xyz for p in points]).reshape(-1, 3),
        colors=np.array([p.color for p in points], dtype=np.uint8).reshape(-1, 3),
        errors=np.array([p.error for p in points], dtype=np.float64),
        track_offsets=np.concatenate([[0], np.cumsum([len(t) for t in tracks])]).astype(np.int64),
        track_images=np.array([row[i] for i, _ in observations], dtype=np.int32),
        track_xy=np.array([pixels[i][k] for i, k in observations]).reshape(-1, 2),
    )


def _plain_camera(camera: pycolmap.Camera) -> Camera:
    return Camera(camera.model_name, camera.width, camera.height, tuple(float(p) for p in camera.params))
