"""A bundle adjustment of a finished model with other cameras or fewer points."""

import numpy as np
import pycolmap

from graphgs.scene.camera import Camera
from graphgs.structure.colmap_jobs.convert import Progress, adjustment, save, set_intrinsics


def adjust(
    model: str,  # folder of a model in COLMAP's format
    out: str,
    points: str | None,  # npy file of the points that take part, as indices in the order of their ids; None: all
    cameras: list[dict],  # fields of graphgs.scene.Camera, in the order of ids of the cameras that have images
    refine: list[str],  # of "poses", "focal", "principal_point", "distortion"
    step: dict,  # loss, loss_scale_px, tolerance
    seed: int,
    threads: int,
    progress: Progress,
    apart: list[int] | None = None,  # images, as indices in the order of ids, that get a camera of their own: the last
) -> dict:
    """Adjust, without filtering: whatever it makes of the model can be compared over the same observations."""
    pycolmap.set_random_seed(seed)
    found = pycolmap.Reconstruction(model)
    if points is not None:
        kept = set(np.load(points, allow_pickle=False).tolist())
        for k, point_id in enumerate(sorted(found.point3D_ids())):
            if k not in kept:
                found.delete_point3D(point_id)
    image_ids = sorted(found.reg_image_ids())
    if apart:
        found = _set_apart(found, [image_ids[k] for k in apart])
    camera_ids = sorted({found.image(i).camera_id for i in image_ids})
    for camera_id, fields in zip(camera_ids, cameras, strict=True):
        set_intrinsics(found.camera(camera_id), Camera(**fields))
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in image_ids:
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(adjustment(step, refine, threads), config, found).solve()
    found.update_point_3d_errors()
    progress(1, 1)
    return save(found, out)


def _set_apart(model: pycolmap.Reconstruction, image_ids: list[int]) -> pycolmap.Reconstruction:
    """The same model with some images that share a camera having one of their own, with the same values to start from.
    An image that is part of a model keeps its camera, so the model is written anew. Points keep their order."""
    made = pycolmap.Reconstruction()
    shared = model.image(image_ids[0]).camera_id
    own = max(model.cameras) + 1
    for camera_id in (*sorted(model.cameras), own):
        fields = model.camera(shared if camera_id == own else camera_id).todict()
        made.add_camera_with_trivial_rig(pycolmap.Camera({**fields, "camera_id": camera_id}))
    apart = set(image_ids)
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        copy = pycolmap.Image(
            name=image.name,
            keypoints=np.array([point.xy for point in image.points2D]).reshape(-1, 2),
            camera_id=own if image_id in apart else image.camera_id,
            image_id=image_id,
        )
        made.add_image_with_trivial_frame(copy, image.cam_from_world())
    for point_id in sorted(model.point3D_ids()):
        point = model.point3D(point_id)
        made.add_point3D(point.xyz, point.track, point.color)
    return made
