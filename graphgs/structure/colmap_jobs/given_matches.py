"""Matches that another program found, verified by COLMAP."""

from pathlib import Path

import numpy as np
import pycolmap

from graphgs.structure.colmap_jobs.convert import Progress


def verify_given(
    database: str,
    matches: str,  # folder of npz files: pairs [P, 2] image indices i < j, offsets [P + 1], matches [M, 2] of keypoints
    verification: dict,  # TwoViewGeometryOptions
    progress: Progress,
) -> dict:
    """Write and verify the matches of all pairs that are not in the database yet."""
    options = pycolmap.TwoViewGeometryOptions()
    options.mergedict(verification)
    files = sorted(Path(matches).glob("*.npz"))
    with pycolmap.Database.open(database) as db:
        images = {image.image_id: image for image in db.read_all_images()}
        cameras = {camera.camera_id: camera for camera in db.read_all_cameras()}
        points = {image_id: db.read_keypoints(image_id)[:, :2].astype(np.float64) for image_id in images}
        for done, file in enumerate(files, 1):
            with np.load(file, allow_pickle=False) as stored:
                pairs, offsets, found = stored["pairs"] + 1, stored["offsets"], stored["matches"].astype(np.uint32)
            with pycolmap.DatabaseTransaction(db):
                for k, (i, j) in enumerate(pairs.tolist()):
                    if db.exists_two_view_geometry(i, j):
                        continue
                    own = found[offsets[k] : offsets[k + 1]]
                    a, b = (cameras[images[image].camera_id] for image in (i, j))
                    geometry = pycolmap.estimate_two_view_geometry(a, points[i], b, points[j], own, options)
                    db.write_matches(i, j, own)
                    db.write_two_view_geometry(i, j, geometry)
            progress(done, len(files))
    return {}
