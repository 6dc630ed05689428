"""When the vote on the focal length is undecided: whether bundle adjustment could find it, or would only wander off."""

import math
from pathlib import Path

from graphgs.structure.cameras import SharedCameras
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.prior import Prior

_AWAY = 1.25  # factor, to both sides: 3 % is within the noise of a few photos
_LEAST_RISE = 0.01  # of the mean reprojection error: straight driving .0007, a room's corner of 8 photos .06
_STEP = {"loss": "SOFT_L1", "loss_scale_px": 1.0, "tolerance": 1e-5}


def is_observable(worker: ColmapWorker, model: Path, *, seed: int, threads: int) -> tuple[bool, float]:
    """(whether the photos of a model object to another focal length, by which share the error then grows).

    The model is adjusted again with the focal length held where it was found, and well above and below that, from one
    start and over the same observations. Straight driving absorbs the change into the depth of the world: the error
    stays what it was."""
    scales = [1.0, 1.0 / _AWAY, _AWAY]
    asked = {"model": model / "colmap", "scales": scales, "step": _STEP, "seed": seed, "threads": threads}
    best, *others = worker.run("focal_response", **asked)["errors"]
    # An adjustment that comes apart is an objection, too.
    rise = min(error if math.isfinite(error) else math.inf for error in others) / max(best, 1e-12) - 1.0
    return rise >= _LEAST_RISE, rise


def cautions(prior: Prior, told: tuple[bool, ...]) -> tuple[str, ...]:
    """What it means for the world if the photos do not show the focal length of a camera, nor anybody tells it (`told`,
    per camera of the prior)."""
    cameras = prior.cameras.cameras
    guessed = sorted({round(camera.params[0]) for camera, known in zip(cameras, told, strict=True) if not known})
    if not (prior.focal_open and guessed):
        return ()
    values = ", ".join(f"{focal} px" for focal in guessed)
    return (
        f"the photos do not show their focal length (straight driving does not), and it was held at {values}, a "
        "typical one: the scene may be stretched along the drive by any factor, without any error that shows. If you "
        "know the focal length, give it with --set sources.focal_px=PIXELS",
    )


def held_note(cameras: SharedCameras, told: tuple[bool, ...]) -> str:
    """e.g. "focal length held at 885 px (typical): straight driving does not show it"."""
    focals = sorted({(round(camera.params[0]), known) for camera, known in zip(cameras.cameras, told, strict=True)})
    values = ", ".join(f"{focal} px ({'EXIF' if known else 'typical'})" for focal, known in focals)
    return f"focal length held at {values}: straight driving does not show it"
