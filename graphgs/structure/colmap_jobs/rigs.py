"""Bundle adjustment of cameras that are fixed on rigs."""

import numpy as np
import pycolmap

from graphgs.structure.colmap_jobs.convert import Progress, adjustment, save


def adjust_rigs(
    model: str,  # folder of a model in COLMAP's format
    out: str,
    rigs: list[dict],  # images: [F, C] pixel files or None; rotations [C, 3, 3], translations [C, 3]: cam_from_rig
    step: dict,  # as one of the rounds of `triangulate`
    refine: list[str],  # of "poses", "focal", "distortion", "principal_point"
    seed: int,
    threads: int,
    progress: Progress,
) -> dict:
    """Bundle adjustment with one pose per frame and one place per camera of a rig, then filtering.

    Each camera of a rig must have intrinsics of its own; photos outside of rigs keep poses of their own."""
    pycolmap.set_random_seed(seed)
    found = pycolmap.Reconstruction(model)
    _mount(found, rigs)
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in sorted(found.reg_image_ids()):
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options = adjustment(step, refine, threads)
    pycolmap.create_default_bundle_adjuster(options, config, found).solve()
    observations = pycolmap.ObservationManager(found)
    observations.filter_all_points3D(step["max_error_px"], step["min_angle_deg"])
    found.update_point_3d_errors()
    progress(1, 1)
    return save(found, out)


def _mount(model: pycolmap.Reconstruction, rigs: list[dict]) -> None:
    """Put the images of rigs into frames that they share; the others keep the frames they have."""
    image_of = {image.name: image for image in model.images.values()}
    mounted, new_rigs, new_frames = set(), [], []
    first_rig, first_frame = max(model.rigs, default=0) + 1, max(model.frames, default=0) + 1
    for rig_id, rig in enumerate(rigs, first_rig):
        places = [
            pycolmap.Rigid3d(pycolmap.Rotation3d(np.array(r)), np.array(t))
            for r, t in zip(rig["rotations"], rig["translations"], strict=True)
        ]
        cameras = {}
        for row in rig["images"]:
            shown = [(c, image_of[name]) for c, name in enumerate(row) if name in image_of]
            if not shown:
                continue
            cameras |= {c: image.camera_id for c, image in shown}
            frame = pycolmap.Frame(frame_id=first_frame + len(new_frames), rig_id=rig_id)
            for _, image in shown:
                frame.add_data_id(image.data_id)
                mounted.add(image.image_id)
            c, image = shown[0]
            frame.rig_from_world = places[c].inverse() * image.cam_from_world()
            new_frames.append(frame)
        sensors = {c: pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera) for c, camera in cameras.items()}
        made = pycolmap.Rig(rig_id=rig_id)
        made.add_ref_sensor(sensors.pop(0))
        for c, sensor in sorted(sensors.items()):
            made.add_sensor(sensor, places[c])
        new_rigs.append(made)
    kept = [frame for frame in model.frames.values() if not mounted & {data.id for data in frame.data_ids}]
    rigs_kept = [model.rigs[rig_id] for rig_id in sorted({frame.rig_id for frame in kept})]
    model.set_rigs_and_frames(rigs_kept + new_rigs, kept + new_frames)
