"""The lenses of a coarse mapping: asked of its photos, and the mapping straightened or made anew with them."""

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.calibration.lens import refinements, undistorted
from graphgs.structure.calibration.opening import self_calibrate
from graphgs.structure.calibration.starts import largest_move, lens_starts
from graphgs.structure.calibration.trials import Trials
from graphgs.structure.cameras import SharedCameras, with_lenses
from graphgs.structure.coarse_mapping import ABOUT_AS_MANY, CoarseMapper, Mapped
from graphgs.structure.database import by_photo_names
from graphgs.structure.two_lenses import two_lenses

_FAR_MOVE = 0.03  # of a focal length, or of the distortion at the corner: poses found with the other one are bent
_MOST_REMAPPINGS = 2
_STRAIGHTENING = {"max_error_px": 4.0, "min_angle_deg": 1.5, "loss": "CAUCHY", "loss_scale_px": 1.0, "tolerance": 1e-5}
_EXPLAINED_PX = 2.0  # an observation further off counts for nothing


def with_lens(mapper: CoarseMapper, found: Mapped, seed: int) -> tuple[Mapped, tuple[str, ...]]:
    """The mapping with the lenses that its photos speak for, and what they determine of them. Where a focal length
    moved far, it is mapped anew as well: poses that were found with a wrong one are bent."""
    photos = mapper.photos
    best, refine, most = found, (), -np.inf
    for turn in range(_MOST_REMAPPINGS + 1):
        trials = _trials(mapper, found, seed)
        own = Reconstruction.load(found.folder)
        starts = lens_starts(photos, found.model, tuple(undistorted(camera) for camera in own.cameras))
        calibration, _ = self_calibrate(trials, own, starts, seed=seed)
        adjusted, _ = trials.run("adjusted", calibration.cameras, calibration.refine)
        straight = _straightened(mapper, found, adjusted, calibration.refine, seed)
        moved, explained = largest_move(own.cameras, calibration.cameras), _explained(straight.model)
        mapper.reporter.event("coarse_lens", turn=turn, moved=moved, explained=explained, **calibration.record())
        if explained > most:
            best, refine, most = straight, calibration.refine, explained
        if moved <= _FAR_MOVE:
            break
        other = mapper.mapped(straight.cameras, seed, f"turn{turn}", hold=True)
        if other is None or len(other.model.names) < ABOUT_AS_MANY * len(found.model.names):
            break
        found = other
    return best, refine


def with_two_lenses(mapper: CoarseMapper, found: Mapped, seed: int) -> tuple[Mapped, str]:
    """The mapping with two cameras where photos that tell no focal length and share one are of two lenses, and a note
    that says so."""
    photos, own = mapper.photos, Reconstruction.load(found.folder)
    if len(found.cameras.cameras) != 1 or any(photo.focal_px for photo in photos.photos):
        return found, ""
    trials = _trials(mapper, found, seed)
    two = two_lenses(trials, own, seed=seed)
    if two is None:
        return found, ""
    adjusted, folder = trials.run("two_lenses", two.model.cameras, ("focal", "k1"), apart=two.apart)
    model = by_photo_names(adjusted, photos)
    row = {name: k for k, name in enumerate(photos.names)}
    ids = found.cameras.camera_ids.copy()
    ids[[row[found.model.names[k]] for k in two.apart]] = 1
    shared = SharedCameras((*found.cameras.cameras, found.cameras.cameras[0]), (True, True), ids)
    cameras = with_lenses(shared, photos, model, model.cameras)
    shown = ", ".join(found.model.names[k] for k in two.apart[:3])
    more = f" and {len(two.apart) - 3} more" if len(two.apart) > 3 else ""
    first, second = (camera.params[0] for camera in cameras.cameras)
    note = f"; the photos are of two lenses, {second:.0f} px for {shown}{more}, {first:.0f} px for the others"
    mapper.reporter.event(
        "two_lenses", photos=[found.model.names[k] for k in two.apart], gain=two.gain, ratio=two.ratio
    )
    return Mapped(model, cameras, folder), note


def _trials(mapper: CoarseMapper, found: Mapped, seed: int) -> Trials:
    scratch = mapper.work / f"{found.folder.name}_lens"
    return Trials(mapper.worker, found.folder, scratch, seed, mapper.threads)


def _straightened(
    mapper: CoarseMapper,
    found: Mapped,
    adjusted: Reconstruction,  # the same by pixel files, with another lens
    refine: tuple[str, ...],
    seed: int,
) -> Mapped:
    """The matches triangulated anew from poses that another lens has moved: many did not fit before."""
    folder = mapper.work / f"{found.folder.name}_straight"
    if not folder.exists():
        start = folder.with_name(f"{folder.name}_from")
        adjusted.save(start)
        mapper.worker.run(
            "triangulate",
            database=mapper.database,
            poses=start,
            out=folder,
            rounds=[_STRAIGHTENING],
            refine=["poses", *refinements(refine)],
            seed=seed,
            threads=mapper.threads,
        )
    model = by_photo_names(Reconstruction.load(folder), mapper.photos)
    return Mapped(model, with_lenses(found.cameras, mapper.photos, model, model.cameras), folder)


def _explained(model: Reconstruction) -> float:
    """What a model makes of its photos: every observation counts the more, the better it fits. A broken model explains
    less than a bent one that bundle adjustment straightened, though its errors may be as small."""
    errors = np.repeat(model.errors, model.track_lengths)
    return float(np.maximum(1.0 - (errors / _EXPLAINED_PX) ** 2, 0.0).sum())
