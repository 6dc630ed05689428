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
