"""Models from the matches in a database: from nothing, or from poses."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pycolmap

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.colmap_jobs.convert import Progress, adjustment, save, set_intrinsics
from graphgs.structure.colmap_jobs.database import set_cameras


def map_incrementally(
    database: str,
    out: str,  # folder for the model
    start: str | None,  # a model to go on from, its poses held
    options: dict,  # IncrementalPipelineOptions
    seed: int,
    threads: int,
    progress: Progress,
    cameras: list[dict] | None = None,  # intrinsics in place of the database's
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

    return _largest(
        out,
        database,
        cameras,
        lambda own, models: pycolmap.incremental_mapping(
            own, models, models, settings, input_path=start or "", next_image_callback=count_one
        ),
    )


def map_globally(
    database: str,
    out: str,  # folder for the model
    refine: bool,  # intrinsics too
    seed: int,
    threads: int,
    progress: Progress,
    cameras: list[dict] | None = None,  # intrinsics in place of the database's
) -> dict:
    """COLMAP's global mapper (GLOMAP, Pan et al. 2024); keeps the model with the most images. It cannot be stopped but
    by ending the process."""
    pycolmap.set_random_seed(seed)
    settings = pycolmap.GlobalPipelineOptions(num_threads=threads, random_seed=seed)
    settings.mapper.num_threads, settings.mapper.random_seed = threads, seed
    adjusting = settings.mapper.bundle_adjustment
    adjusting.refine_focal_length = adjusting.refine_extra_params = refine
    adjusting.ceres.use_gpu = settings.mapper.global_positioning.use_gpu = False
    progress(0, 1)
    return _largest(out, database, cameras, lambda own, models: pycolmap.global_mapping(own, models, models, settings))


def triangulate(
    database: str,
    poses: str,  # folder of a Reconstruction whose names are pixel files
    out: str,
    rounds: list[dict],  # each: max_error_px, min_angle_deg, loss (a pycolmap LossFunctionType), loss_scale_px, and
    # tolerance (relative decrease of the cost at which bundle adjustment stops)
    refine: list[str],  # of "poses", "focal", "distortion", "principal_point"
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
    camera_of = {image.name: image.camera_id for image in cache.images.values()}
    for k, name in enumerate(given.names):
        if name in camera_of:  # the model of the lens too may be another than the database's
            set_intrinsics(cache.cameras[camera_of[name]], given.camera_of(k))
    model = pycolmap.Reconstruction()
    model.load(cache)
    ids = {image.name: image_id for image_id, image in model.images.items()}
    for k, name in enumerate(given.names):
        if name not in ids:
            continue  # no verified match: nothing to triangulate
        image = model.image(ids[name])
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(given.rotations[k]), given.translations[k])
        model.frame(image.frame_id).set_cam_from_world(image.camera_id, pose)
        model.register_frame(image.frame_id)
    mapper = pycolmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(model)
    for index, step in enumerate(rounds):
        _round(mapper, model, step, refine, seed, threads)
        progress(index + 1, len(rounds))
    mapper.end_reconstruction(discard=False)
    return save(model, out)


def _largest(
    out: str,
    database: str,
    cameras: list[dict] | None,
    run: Callable[[str, Path], dict[int, pycolmap.Reconstruction]],
) -> dict:
    """Keep the model with the most images that a mapper makes in a folder of its own, from a database with these
    cameras."""
    models = Path(out + ".models")
    shutil.rmtree(models, ignore_errors=True)
    models.mkdir(parents=True)
    if cameras is not None:  # the matches are an artefact, which stays as it is
        database = shutil.copyfile(database, str(models / "database.db"))
        set_cameras(database, cameras, progress=lambda done, total: None)
    found = run(database, models)
    shutil.rmtree(models)
    if not found:
        return {"registered": 0}
    best = max(found, key=lambda k: (found[k].num_reg_images(), -k))
    return save(found[best], out)


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
        mapper.adjust_global_bundle(options, adjustment(step, refine, threads))
    mapper.filter_points(options)
    if refine:
        mapper.filter_frames(options)  # photos that no point supports any more
