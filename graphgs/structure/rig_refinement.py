"""The last bundle adjustment of a rig: one pose per frame and one place per camera, where the photos allow it."""

import dataclasses

import numpy as np

from graphgs.progress import Reporter
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.sources.rigs import Rig
from graphgs.structure.model_calls import ModelCalls
from graphgs.structure.rigs import RigPose, rig_pose

_LARGEST_ERROR_RATIO = 1.1  # of mean reprojection errors, constrained to free: more, and the cameras did not keep still


def rig_poses(photos: Photos, model: Reconstruction, free: Reconstruction | None = None) -> tuple[RigPose, ...]:
    """Where the cameras of each rig sit. How much they moved is what `free` says, a reconstruction of the same size in
    which every photo had a pose of its own."""
    poses = tuple(rig_pose(rig, photos.names, model) for rig in photos.rigs)
    if free is None:
        return poses
    before = rig_poses(photos, free)
    return tuple(
        dataclasses.replace(pose, turn_deg=was.turn_deg, move=was.move, rigid=was.rigid)
        for pose, was in zip(poses, before, strict=True)
    )


def constrained(
    mapper: ModelCalls,
    name: str,  # of the model in scratch
    model: Reconstruction,  # the same, by photo names
    reporter: Reporter,
) -> Reconstruction | None:
    """The model with rigid rigs, or None where no rig is rigid or the photos object to it."""
    photos = mapper.photos
    poses = rig_poses(photos, model)
    rigid = [
        (rig, pose)
        for rig, pose in zip(photos.rigs, poses, strict=True)
        if pose.rigid and _own_cameras(rig, mapper.prior.cameras.camera_ids)
    ]
    if not rigid:
        return None
    found = mapper.rig_adjusted(name, rigid)
    if found is None or not len(found.points):
        return None
    ratio = float(found.errors.mean() / model.errors.mean())
    taken = ratio <= _LARGEST_ERROR_RATIO and len(found.names) == len(model.names)
    reporter.event("rig_adjustment", rigs=len(rigid), error_ratio=ratio, taken=taken)
    return found if taken else None


def _own_cameras(rig: Rig, camera_ids: np.ndarray) -> bool:
    """Whether every camera of the rig has intrinsics of its own, and only one set of them."""
    sets = [set(camera_ids[column[column >= 0]].tolist()) for column in rig.photos.T]
    return all(len(own) == 1 for own in sets) and len(set().union(*sets)) == len(sets)
