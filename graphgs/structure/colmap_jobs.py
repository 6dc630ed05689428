"""What GraphGS asks of COLMAP. The only module that imports pycolmap; it runs in a child process (`colmap_worker`).

Each job takes plain values and leaves its result in files, so that a killed job costs only itself: features and matches
go to the database image by image and pair by pair, a model appears by one rename.
"""

import shutil
import sqlite3
import zlib  # noqa: F401  (zlib and numpy first: pycolmap bundles libraries of the same names)
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction

Progress = Callable[[int, int], None]


def extract(
    root: str,
    images: list[str],  # pixel files below root
    masks: list[str | None],  # mask files below root; 0 = no features here
    out: str,  # folder for <image>.npz: keypoints [F, 4] (x, y, scale, orientation; file px), descriptors [F, 128]
    max_side: int,  # [px] images are reduced to it first
    max_features: int,
    first_octave: int,
    progress: Progress,
) -> dict:
    """SIFT features of some images, one file each."""
    cv2.setNumThreads(1)
    options = pycolmap.FeatureExtractionOptions(num_threads=1, use_gpu=False)
    options.sift.max_num_features = max_features
    options.sift.first_octave = first_octave
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    for count, (name, mask) in enumerate(zip(images, masks, strict=True), 1):
        keypoints, described = _sift(extractor, Path(root), name, mask, max_side)
        target = Path(out) / f"{name}.npz"
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_suffix(".partial.npz")
        np.savez(partial, keypoints=keypoints, descriptors=described)
        partial.rename(target)
        progress(count, len(images))
    return {}


def _sift(extractor, root: Path, name: str, mask: str | None, max_side: int) -> tuple[np.ndarray, np.ndarray]:
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    image = cv2.imread(str(root / name), flags)
    if image is None:
        raise OSError(f"{root / name}: cannot read the decoded photo")
    height, width = image.shape
    scale = min(1.0, max_side / max(height, width))
    if scale < 1.0:
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    found, described = extractor.extract_from_uint8_array(image)
    keypoints = pycolmap.keypoints_to_matrix(found)
    keypoints[:, :2] *= (width / image.shape[1], height / image.shape[0])
    keypoints[:, 2] *= width / image.shape[1]
    descriptors = described.data.reshape(-1, 128)
    if mask is not None:
        allowed = cv2.imread(str(root / mask), cv2.IMREAD_GRAYSCALE)
        if allowed is None:
            raise OSError(f"{root / mask}: cannot read the mask")
        columns = np.clip(keypoints[:, 0].astype(int), 0, width - 1)
        rows = np.clip(keypoints[:, 1].astype(int), 0, height - 1)
        keep = allowed[rows, columns] > 127
        keypoints, descriptors = keypoints[keep], descriptors[keep]
    return keypoints, descriptors


def create_database(
    database: str,
    images: list[str],  # [N] pixel files; image i gets the id i + 1
    camera_of_image: list[int],  # [N] into `cameras`
    cameras: list[dict],  # fields of graphgs.scene.Camera, and `known`: the focal length is more than a guess
    features: str,  # folder that `extract` filled
    progress: Progress,
) -> dict:
    """A database of images, shared cameras and features. It appears by one rename."""
    path, partial = Path(database), Path(database + ".partial")
    for leftover in path.parent.glob(partial.name + "*"):
        leftover.unlink()
    with pycolmap.Database.open(partial) as db:
        for camera_id, fields in enumerate(cameras, 1):
            db.write_camera(_camera(camera_id, fields), use_camera_id=True)
            rig = pycolmap.Rig(rig_id=camera_id)
            rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id))
            db.write_rig(rig, use_rig_id=True)
        for image_id, (name, camera) in enumerate(zip(images, camera_of_image, strict=True), 1):
            image = pycolmap.Image(name=name, camera_id=camera + 1, image_id=image_id)
            db.write_image(image, use_image_id=True)
            frame = pycolmap.Frame(frame_id=image_id, rig_id=camera + 1)
            frame.add_data_id(image.data_id)
            db.write_frame(frame, use_frame_id=True)
            with np.load(Path(features) / f"{name}.npz", allow_pickle=False) as arrays:
                db.write_keypoints(image_id, arrays["keypoints"])
                described = pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, arrays["descriptors"])
                db.write_descriptors(image_id, described)
    _settle(partial)
    partial.rename(path)
    return {}


def set_cameras(database: str, cameras: list[dict], progress: Progress) -> dict:
    """Replace the intrinsics of every camera."""
    with pycolmap.Database.open(database) as db:
        for camera_id, fields in enumerate(cameras, 1):
            db.update_camera(_camera(camera_id, fields))
    return {}


def match(
    database: str,
    pairs: list[tuple[int, int]],  # image indices
    chunk_pairs: int,
    matching: dict,  # FeatureMatchingOptions
    verification: dict,  # TwoViewGeometryOptions
    threads: int,
    scratch: str,
    progress: Progress,
) -> dict:
    """Match and verify the given pairs, a chunk at a time; pairs in the database already are passed over."""
    matching_options = pycolmap.FeatureMatchingOptions(num_threads=threads, use_gpu=False)
    matching_options.mergedict(matching)
    verification_options = pycolmap.TwoViewGeometryOptions()
    verification_options.mergedict(verification)
    with pycolmap.Database.open(database) as db:
        names = [db.read_image(i + 1).name for i in range(db.num_images())]
        pending = [(i, j) for i, j in pairs if not db.exists_two_view_geometry(i + 1, j + 1)]
    listing = Path(scratch) / "pairs.txt"
    finished = len(pairs) - len(pending)
    progress(finished, len(pairs))
    for first in range(0, len(pending), chunk_pairs):
        chunk = pending[first : first + chunk_pairs]
        listing.write_text("".join(f"{names[i]} {names[j]}\n" for i, j in chunk))
        pycolmap.match_image_pairs(
            database,
            matching_options,
            pycolmap.ImportedPairingOptions(match_list_path=listing),
            verification_options,
            pycolmap.Device.cpu,
        )
        finished += len(chunk)
        progress(finished, len(pairs))
    return {"matched_now": len(pending)}


def verified(database: str, out: str, progress: Progress) -> dict:
    """The verified pairs in one npz: `edges` [E, 2] image indices i < j, sorted; `inliers` [E]."""
    with pycolmap.Database.open(database) as db:
        pair_ids, counts = db.read_two_view_geometry_num_inliers()
        pairs = [pycolmap.pair_id_to_image_pair(p) for p in pair_ids]
    edges = np.array(pairs, dtype=np.int64).reshape(-1, 2) - 1
    inliers = np.array(counts, dtype=np.int64)
    keep = inliers > 0
    edges, inliers = edges[keep], inliers[keep]
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    np.savez(out, edges=edges[order], inliers=inliers[order])
    return {}


def fundamentals(database: str, out: str, progress: Progress) -> dict:
    """The fundamental matrices of verified pairs in general position, in one npz: `pairs` [P, 2], `F` [P, 3, 3] with
    x_j^T F x_i = 0 in px, `inliers` [P]."""
    general = {
        int(pycolmap.TwoViewGeometryConfiguration.CALIBRATED),
        int(pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED),
    }
    with pycolmap.Database.open(database) as db:
        pair_ids, geometries = db.read_two_view_geometries()
    chosen = [
        (pycolmap.pair_id_to_image_pair(pair_id), geometry)
        for pair_id, geometry in zip(pair_ids, geometries, strict=True)
        if geometry.config in general and geometry.F is not None
    ]
    np.savez(
        out,
        pairs=np.array([pair for pair, _ in chosen], dtype=np.int64).reshape(-1, 2) - 1,
        F=np.array([geometry.F for _, geometry in chosen]).reshape(-1, 3, 3),
        inliers=np.array([len(geometry.inlier_matches) for _, geometry in chosen], dtype=np.int64),
    )
    return {}


def settle(database: str, progress: Progress) -> dict:
    """Fold the write-ahead log into the database, so that the one file is the whole of it."""
    _settle(Path(database))
    return {}


def map_incrementally(
    database: str,
    out: str,  # folder for the model
    start: str | None,  # a model to go on from, its poses held
    options: dict,  # IncrementalPipelineOptions
    seed: int,
    threads: int,
    progress: Progress,
) -> dict:
    """COLMAP's incremental mapper; keeps the model with the most images."""
    pycolmap.set_random_seed(seed)
    settings = pycolmap.IncrementalPipelineOptions(num_threads=threads, random_seed=seed, extract_colors=False)
    settings.mergedict(options)
    settings.fix_existing_frames = start is not None
    settings.mapper.random_seed = settings.triangulation.random_seed = seed
    with pycolmap.Database.open(database) as db:
        total = db.num_images()
    registered = 0

    def count_one() -> None:
        nonlocal registered
        registered += 1
        progress(min(registered, total), total)

    models = Path(out + ".models")
    shutil.rmtree(models, ignore_errors=True)
    models.mkdir(parents=True)
    found = pycolmap.incremental_mapping(
        database, models, models, settings, input_path=start or "", next_image_callback=count_one
    )
    shutil.rmtree(models)
    if not found:
        return {"registered": 0}
    best = max(found, key=lambda k: (found[k].num_reg_images(), -k))
    return _save(found[best], out)


def triangulate(
    database: str,
    poses: str,  # folder of a Reconstruction whose names are pixel files
    out: str,
    rounds: list[dict],  # each: max_error_px, min_angle_deg, loss (a pycolmap LossFunctionType), loss_scale_px, and
    # tolerance (relative decrease of the cost at which bundle adjustment stops)
    refine: list[str],  # of "poses", "intrinsics", "principal_point"
    seed: int,
    threads: int,
    progress: Progress,
) -> dict:
    """Triangulate the database's matches from given poses, then bundle adjustment and filtering, in rounds.

    What `refine` does not name stays exactly as given."""
    pycolmap.set_random_seed(seed)
    given = Reconstruction.load(Path(poses))
    with pycolmap.Database.open(database) as db:
        # Poses that are kept stay even where no match supports them.
        cache = pycolmap.DatabaseCache.create(db, pycolmap.DatabaseCacheOptions(load_all_images=not refine))
    model = pycolmap.Reconstruction()
    model.load(cache)
    ids = {image.name: image_id for image_id, image in model.images.items()}
    for k, name in enumerate(given.names):
        if name not in ids:
            continue  # no verified match: nothing to triangulate
        image = model.image(ids[name])
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(given.rotations[k]), given.translations[k])
        camera = model.camera(image.camera_id)
        _set_intrinsics(camera, given.camera_of(k))
        model.frame(image.frame_id).set_cam_from_world(image.camera_id, pose)
        model.register_frame(image.frame_id)
    mapper = pycolmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(model)
    for index, step in enumerate(rounds):
        _round(mapper, model, step, refine, seed, threads)
        progress(index + 1, len(rounds))
    mapper.end_reconstruction(discard=False)
    return _save(model, out)


def adjust_rigs(
    model: str,  # folder of a model in COLMAP's format
    out: str,
    rigs: list[dict],  # images: [F, C] pixel files or None; rotations [C, 3, 3], translations [C, 3]: cam_from_rig
    step: dict,  # as one of the rounds of `triangulate`
    refine: list[str],  # of "poses", "intrinsics", "principal_point"
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
    adjustment = _adjustment(step, refine, threads)
    pycolmap.create_default_bundle_adjuster(adjustment, config, found).solve()
    observations = pycolmap.ObservationManager(found)
    observations.filter_all_points3D(step["max_error_px"], step["min_angle_deg"])
    found.update_point_3d_errors()
    progress(1, 1)
    return _save(found, out)


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


def _adjustment(step: dict, refine: list[str], threads: int) -> pycolmap.BundleAdjustmentOptions:
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    options.refine_rig_from_world = "poses" in refine
    options.refine_focal_length = options.refine_extra_params = "intrinsics" in refine
    options.refine_principal_point = "principal_point" in refine
    options.ceres.loss_function_type = getattr(pycolmap.LossFunctionType, step["loss"])
    options.ceres.loss_function_scale = step["loss_scale_px"]
    options.ceres.solver_options.num_threads = threads
    options.ceres.solver_options.max_num_iterations = 100
    options.ceres.solver_options.function_tolerance = step["tolerance"]
    return options


def _round(mapper, model, step: dict, refine: list[str], seed: int, threads: int) -> None:
    options = pycolmap.IncrementalMapperOptions(num_threads=threads, random_seed=seed)
    options.filter_max_reproj_error = step["max_error_px"]
    options.filter_min_tri_angle = step["min_angle_deg"]
    finding = pycolmap.IncrementalTriangulatorOptions(random_seed=seed)
    finding.merge_max_reproj_error = finding.complete_max_reproj_error = step["max_error_px"]
    finding.min_angle = step["min_angle_deg"]
    for image_id in sorted(model.reg_image_ids()):
        mapper.triangulate_image(finding, image_id)
    mapper.complete_and_merge_tracks(finding)
    mapper.retriangulate(finding)
    if refine:
        mapper.adjust_global_bundle(options, _adjustment(step, refine, threads))
    mapper.filter_points(options)
    if refine:
        mapper.filter_frames(options)  # photos that no point supports any more


def _camera(camera_id: int, fields: dict) -> pycolmap.Camera:
    camera = pycolmap.Camera(
        camera_id=camera_id,
        model=fields["model"],
        width=fields["width"],
        height=fields["height"],
        params=list(fields["params"]),
    )
    camera.has_prior_focal_length = fields["known"]
    return camera


def _set_intrinsics(camera: pycolmap.Camera, source: Camera) -> None:
    camera.model = getattr(pycolmap.CameraModelId, source.model)
    camera.width, camera.height, camera.params = source.width, source.height, list(source.params)


def _settle(database: Path) -> None:
    connection = sqlite3.connect(database)
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    connection.execute("PRAGMA journal_mode=DELETE")
    connection.close()


def _save(model: pycolmap.Reconstruction, out: str) -> dict:
    """The model in COLMAP's format (to go on from) and as a Reconstruction, in one folder that appears at once."""
    partial, final = Path(out + ".partial"), Path(out)
    shutil.rmtree(partial, ignore_errors=True)
    (partial / "colmap").mkdir(parents=True)
    model.write_binary(partial / "colmap")
    _reconstruction(model).save(partial)
    shutil.rmtree(final, ignore_errors=True)
    partial.rename(final)
    return {"registered": model.num_reg_images()}


def _reconstruction(model: pycolmap.Reconstruction) -> Reconstruction:
    """Plain arrays, in the order of ids. Names are pixel files."""
    image_ids = sorted(model.reg_image_ids())
    images = [model.image(i) for i in image_ids]
    camera_ids = sorted({image.camera_id for image in images})
    poses = [image.cam_from_world() for image in images]
    row = {image_id: k for k, image_id in enumerate(image_ids)}
    pixels = {image.image_id: np.array([p.xy for p in image.points2D]).reshape(-1, 2) for image in images}
    point_ids = sorted(model.point3D_ids())
    points = [model.point3D(p) for p in point_ids]
    tracks = [sorted((e.image_id, e.point2D_idx) for e in p.track.elements) for p in points]
    observations = [pair for track in tracks for pair in track]
    return Reconstruction(
        cameras=tuple(_plain_camera(model.camera(c)) for c in camera_ids),
        names=tuple(image.name for image in images),
        camera_ids=np.array([camera_ids.index(image.camera_id) for image in images], dtype=np.int64),
        rotations=np.array([p.rotation.matrix() for p in poses]).reshape(-1, 3, 3),
        translations=np.array([p.translation for p in poses]).reshape(-1, 3),
        points=np.array([p.xyz for p in points]).reshape(-1, 3),
        colors=np.array([p.color for p in points], dtype=np.uint8).reshape(-1, 3),
        errors=np.array([p.error for p in points], dtype=np.float64),
        track_offsets=np.concatenate([[0], np.cumsum([len(t) for t in tracks])]).astype(np.int64),
        track_images=np.array([row[i] for i, _ in observations], dtype=np.int32),
        track_xy=np.array([pixels[i][k] for i, k in observations]).reshape(-1, 2),
    )


def _plain_camera(camera: pycolmap.Camera) -> Camera:
    return Camera(camera.model_name, camera.width, camera.height, tuple(float(p) for p in camera.params))


JOBS = {
    job.__name__: job
    for job in (
        extract,
        create_database,
        set_cameras,
        match,
        verified,
        fundamentals,
        settle,
        map_incrementally,
        triangulate,
        adjust_rigs,
    )
}
