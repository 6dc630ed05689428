"""A model from poses, its lenses asked between the wide and the narrow round of bundle adjustment."""

import dataclasses

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.calibration.lens import opened, undistorted
from graphgs.structure.calibration.opening import self_calibrate
from graphgs.structure.calibration.starts import largest_move, lens_starts
from graphgs.structure.calibration.trials import Trials
from graphgs.structure.cameras import with_lenses
from graphgs.structure.database import by_photo_names
from graphgs.structure.model_calls import NARROW, WIDE, ModelCalls

_MOVED = 0.01  # of a focal length, or of the distortion at the corner: beyond, points are looked for widely once more


def calibrated(calls: ModelCalls, poses: Reconstruction, name: str) -> tuple[ModelCalls, Reconstruction | None]:
    """(the calls with what the photos say of their lenses, the model of that name made with it): triangulated from
    poses, adjusted, asked, and adjusted with just what the photos determine. None: nothing could be triangulated."""
    wide = calls.adjusted(poses, f"{name}_wide", rounds=(WIDE,))
    if wide is None:
        return calls, None
    folder = calls.scratch / f"{name}_wide"
    trials = Trials(calls.worker, folder, calls.scratch / f"{name}_lens", calls.seed, calls.threads)
    row = {photo: k for k, photo in enumerate(calls.photos.names)}
    prior_camera = {
        int(own): undistorted(calls.prior.cameras.cameras[calls.prior.cameras.camera_ids[row[photo]]])
        for photo, own in zip(wide.names, wide.camera_ids, strict=True)
    }
    starts = lens_starts(calls.photos, wide, tuple(prior_camera[k] for k in range(len(wide.cameras))))
    calibration, posed = self_calibrate(trials, Reconstruction.load(folder), starts, seed=calls.seed)
    moved = largest_move(wide.cameras, calibration.cameras)
    calls.reporter.event("lens", name=name, moved=moved, **calibration.record())
    calls = calls.with_calibration(calibration, wide)
    posed = dataclasses.replace(by_photo_names(posed, calls.photos), cameras=calibration.cameras)
    rounds = (WIDE, NARROW) if moved > _MOVED else (NARROW,)
    return calls, calls.adjusted(posed, name, rounds=rounds)


def with_parameters(
    calls: ModelCalls, model: Reconstruction, name: str, parameters: tuple[str, ...]
) -> tuple[ModelCalls, Reconstruction | None]:
    """(the calls, the model of that name) with just these parameters of the lenses free, whatever the photos say."""
    lenses = tuple(opened(undistorted(camera), parameters) for camera in model.cameras)
    prior = dataclasses.replace(
        calls.prior, cameras=with_lenses(calls.prior.cameras, calls.photos, model, lenses), refine=parameters
    )
    calls = dataclasses.replace(calls, prior=prior)
    return calls, calls.adjusted(dataclasses.replace(model, cameras=lenses), name, rounds=(WIDE, NARROW))
