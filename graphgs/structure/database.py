"""From Photos to COLMAP's database and back: shared cameras, masks, and names instead of pixel files."""

import dataclasses
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.colmap import ColmapWorker

_GUESSED_FOCAL = 1.2  # of the longer side: COLMAP's guess for a photo that does not tell


@dataclasses.dataclass(frozen=True)
class SharedCameras:
    """The cameras of a set of photos: photos with the same `camera_key` share one."""

    cameras: tuple[Camera, ...]
    known: tuple[bool, ...]  # the focal length is from EXIF or a reconstruction, not a guess
    camera_ids: np.ndarray  # [N] int, into `cameras`

    def records(self) -> list[dict]:
        return [{**dataclasses.asdict(c), "known": k} for c, k in zip(self.cameras, self.known, strict=True)]


def shared_cameras(photos) -> SharedCameras:
    """SIMPLE_RADIAL per camera key: one focal length and one distortion term hold phones and calibrated rigs alike, and
    cannot run away on weak geometry as models with more terms do."""
    keys = sorted({photo.camera_key for photo in photos.photos})
    cameras, known = [], []
    for key in keys:
        group = [photo for photo in photos.photos if photo.camera_key == key]
        width, height = group[0].width, group[0].height
        told = [photo.focal_px for photo in group if photo.focal_px]
        focal = float(np.median(told)) if told else _GUESSED_FOCAL * max(width, height)
        cameras.append(Camera("SIMPLE_RADIAL", width, height, (focal, width / 2, height / 2, 0.0)))
        known.append(bool(told))
    ids = np.array([keys.index(photo.camera_key) for photo in photos.photos], dtype=np.int64)
    return SharedCameras(tuple(cameras), tuple(known), ids)


def refined_by(cameras: SharedCameras, photos, reconstruction: Reconstruction | None) -> SharedCameras:
    """The same cameras with the intrinsics of a reconstruction of these photos, where it has them."""
    if reconstruction is None:
        return cameras
    row = {name: k for k, name in enumerate(reconstruction.names)}
    refined, known = list(cameras.cameras), list(cameras.known)
    for photo, camera in zip(photos.photos, cameras.camera_ids, strict=True):
        if photo.name in row:
            refined[camera], known[camera] = reconstruction.camera_of(row[photo.name]), True
    return dataclasses.replace(cameras, cameras=tuple(refined), known=tuple(known))


def build_features(
    worker: ColmapWorker,
    database: Path,
    photos,
    cameras: SharedCameras,
    *,
    max_side: int,
    max_features: int,
    first_octave: int,
    scratch: Path,
    threads: int,
    progress: Callable[[int, int], None],
) -> np.ndarray:
    """Make or continue the database and give every photo its features. Returns their number [N]."""
    images = [photo.pixels for photo in photos.photos]
    if not database.exists():
        worker.run(
            "create_database",
            database=database,
            images=images,
            camera_of_image=cameras.camera_ids.tolist(),
            cameras=cameras.records(),
        )
    done = worker.run(
        "extract",
        progress=progress,
        database=database,
        root=photos.folder,
        images=images,
        mask_root=_mask_root(photos, scratch),
        max_side=max_side,
        max_features=max_features,
        first_octave=first_octave,
        threads=threads,
    )
    return np.array(done["features"], dtype=np.int64)


def _mask_root(photos, scratch: Path) -> Path | None:
    """Masks under the names that COLMAP looks for; photos without one have none there."""
    masked = [photo for photo in photos.photos if photo.mask is not None]
    if not masked:
        return None
    root = scratch / "masks"
    for photo in masked:
        target = root / (photo.pixels + ".png")
        target.parent.mkdir(parents=True, exist_ok=True)
        if not target.exists():
            link_or_copy(photos.folder / photo.mask, target)
    return root


def link_or_copy(source: Path, target: Path) -> None:
    """A hard link where the file system has them: no second copy of a large file."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def by_photo_names(reconstruction: Reconstruction, photos) -> Reconstruction:
    """Photo names in place of pixel files. Both sort alike, since pixel files are numbered in the order of names."""
    name_of = {photo.pixels: photo.name for photo in photos.photos}
    return dataclasses.replace(reconstruction, names=tuple(name_of[n] for n in reconstruction.names))


def by_pixel_files(reconstruction: Reconstruction, photos) -> Reconstruction:
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
