"""From Photos to COLMAP's database and back: photo names in place of pixel files."""

import dataclasses
import os
import shutil
from pathlib import Path

from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.structure.cameras import SharedCameras
from graphgs.structure.colmap import ColmapWorker


def create_database(
    worker: ColmapWorker, database: Path, photos: Photos, cameras: SharedCameras, features: Path
) -> None:
    """The database of the photos with the features in a folder of `extract_features`, unless it is there already."""
    if not database.exists():
        worker.run(
            "create_database",
            database=database,
            images=[photo.pixels for photo in photos.photos],
            camera_of_image=cameras.camera_ids.tolist(),
            cameras=cameras.records(),
            features=features,
        )


def link_or_copy(source: Path, target: Path) -> None:
    """A hard link where the file system has them: no second copy of a large file."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def copy_whole(source: Path, target: Path) -> None:
    """A copy to write to, which is whole or not there."""
    partial = target.with_suffix(".partial")
    shutil.copyfile(source, partial)
    partial.rename(target)


def by_photo_names(reconstruction: Reconstruction, photos: Photos) -> Reconstruction:
    """Photo names in place of pixel files. Both sort alike, since pixel files are numbered in the order of names."""
    name_of = {photo.pixels: photo.name for photo in photos.photos}
    return dataclasses.replace(reconstruction, names=tuple(name_of[n] for n in reconstruction.names))


def by_pixel_files(reconstruction: Reconstruction, photos: Photos) -> Reconstruction:
    """The other way, leaving out images that are not among the photos (their tracks are dropped: poses only)."""
    file_of = {photo.name: photo.pixels for photo in photos.photos}
    keep = [k for k, name in enumerate(reconstruction.names) if name in file_of]
    return Reconstruction(
        cameras=reconstruction.cameras,
        names=tuple(file_of[reconstruction.names[k]] for k in keep),
        camera_ids=reconstruction.camera_ids[keep],
        rotations=reconstruction.rotations[keep],
        translations=reconstruction.translations[keep],
    )
