"""The usual mistakes in poses from elsewhere, undone. The settings `sources.given_*` ask for it; and where poses do not
fit their photos, the structure stage tries which of these would make them fit.
"""

import dataclasses

import numpy as np

from graphgs.scene.camera import ONE_FOCAL, Camera
from graphgs.scene.names import as_counted, as_text
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.config import SourcesConfig
from graphgs.sources.transforms import OURS_FROM_OPENGL

ORDERS = {"number": as_counted, "text": as_text}  # besides "name"


def mended(poses: Reconstruction, config: SourcesConfig, axes: str) -> Reconstruction:
    """`poses`, read as the format says with cameras in `axes` (opencv or opengl), as the settings want them read."""
    wanted = axes if config.given_axes == "auto" else config.given_axes
    if wanted != axes:
        poses = axes_flipped(poses)
    if config.given_inverse:
        poses = inverted(poses, wanted)
    if config.given_order != "name":
        poses = reordered(poses, config.given_order)
    if config.given_scale != 1.0:
        poses = rescaled(poses, config.given_scale)
    return without_points(poses) if config.given_points == "drop" else poses


def axes_flipped(poses: Reconstruction) -> Reconstruction:
    """Cameras that were written with the other axes: y and z change sign, the places stay."""
    return dataclasses.replace(
        poses, rotations=OURS_FROM_OPENGL @ poses.rotations, translations=poses.translations @ OURS_FROM_OPENGL
    )


def inverted(poses: Reconstruction, axes: str) -> Reconstruction:
    """Matrices that were written the other way round: what was read as the camera in the world takes the world into the
    camera, whose axes are `axes`, or the other way."""
    turn = OURS_FROM_OPENGL if axes == "opengl" else np.eye(3)
    rotations = turn @ poses.rotations.transpose(0, 2, 1) @ turn
    return dataclasses.replace(poses, rotations=rotations, translations=poses.centers @ turn)


def reordered(poses: Reconstruction, order: str) -> Reconstruction:
    """Poses that were listed for photos in another order than that of their names: the first goes to the first photo in
    the wanted order. What a pose sees (tracks) goes with it; intrinsics stay with the photos."""
    place = ORDERS[order](poses.names)  # photo that gets the k-th pose
    pose_of = np.argsort(place)
    return dataclasses.replace(
        poses,
        rotations=poses.rotations[pose_of],
        translations=poses.translations[pose_of],
        track_images=place[poses.track_images].astype(np.int32),
    )


def rescaled(poses: Reconstruction, factor: float) -> Reconstruction:
    """Intrinsics that belong to photos of another size, times `factor`; the stated sizes stay."""
    cameras = []
    for camera in poses.cameras:
        count = 3 if camera.model in ONE_FOCAL else 4  # then distortion, which has no size
        params = (*(p * factor for p in camera.params[:count]), *camera.params[count:])
        cameras.append(Camera(camera.model, camera.width, camera.height, params))
    return dataclasses.replace(poses, cameras=tuple(cameras))


def without_points(poses: Reconstruction) -> Reconstruction:
    """Poses and intrinsics alone."""
    return Reconstruction(poses.cameras, poses.names, poses.camera_ids, poses.rotations, poses.translations)
