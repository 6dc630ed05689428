"""What the photos say against another focal length."""

import numpy as np
import pycolmap

from graphgs.structure.colmap_jobs.convert import Progress, adjustment


def focal_response(
    model: str,  # folder of a model in COLMAP's format
    scales: list[float],  # of all focal lengths
    step: dict,  # as one of the rounds of `triangulate`
    seed: int,
    threads: int,
    progress: Progress,
) -> dict:
    """Bundle adjustment with every focal length held at a multiple of what it is: for each multiple, the mean
    reprojection error [px] over the same observations. Poses, points and distortion adapt as they can."""
    errors = []
    for count, scale in enumerate(scales, 1):
        pycolmap.set_random_seed(seed)
        found = pycolmap.Reconstruction(model)
        for camera in found.cameras.values():
            params = np.array(camera.params)
            params[list(camera.focal_length_idxs())] *= scale
            camera.params = params
        config = pycolmap.BundleAdjustmentConfig()
        for image_id in sorted(found.reg_image_ids()):
            config.add_image(image_id)
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
        options = adjustment(step, ["poses", "intrinsics"], threads)
        options.refine_focal_length = False
        pycolmap.create_default_bundle_adjuster(options, config, found).solve()
        found.update_point_3d_errors()
        errors.append(found.compute_mean_reprojection_error())
        progress(count, len(scales))
    return {"errors": errors}
