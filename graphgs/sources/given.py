"""Poses from elsewhere, brought to the photos: names matched, cameras turned upright and scaled to the decoded size."""

import dataclasses
from collections import Counter, defaultdict

import numpy as np

from graphgs.errors import DataError
from graphgs.scene.camera import ONE_FOCAL, Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.decode import same_shape
from graphgs.sources.photos import Photo

QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # new from old, image turned clockwise
TURNS = {1: 0, 6: 1, 3: 2, 8: 3}  # clockwise quarter turns of an EXIF orientation; the others mirror
HINT = "give the folder of photos alone, and the poses are found from them"


def match_names(given: tuple[str, ...], photos: tuple[str, ...]) -> dict[str, int]:
    """Index into `given` by photo name. Equal names match; if none is equal, names that differ by one and the same
    leading folder do ("images/a.jpg" and "a.jpg"). Raises DataError where two such folders match equally well."""
    exact = {name: i for i, name in enumerate(given)}
    if any(name in exact for name in photos):
        return {name: exact[name] for name in photos if name in exact}
    by_file = defaultdict(list)
    for name in given:
        by_file[name.rpartition("/")[2]].append(name)
    votes: Counter[tuple[str, str]] = Counter()  # (folder only the given name has, folder only the photo has)
    for name in photos:
        for other in by_file[name.rpartition("/")[2]]:
            if other.endswith("/" + name):
                votes[other.removesuffix(name), ""] += 1
            elif name.endswith("/" + other):
                votes["", name.removesuffix(other)] += 1
    if not votes:
        return {}
    ranked = votes.most_common(2)
    if len(ranked) == 2 and ranked[0][1] == ranked[1][1]:
        folders = " or ".join("".join(shift) for shift, _ in ranked)
        raise DataError(f"the poses match the photos under two folders alike: {folders}", hint=HINT)
    add, drop = ranked[0][0]
    return {
        name: exact[add + name.removeprefix(drop)]
        for name in photos
        if name.startswith(drop) and add + name.removeprefix(drop) in exact
    }


def fit_to_photos(poses: Reconstruction, photos: tuple[Photo, ...]) -> Reconstruction:
    """`poses` for the decoded photos: named and sorted as they are, upright, cameras at the decoded size.

    COLMAP ignores EXIF orientation, so poses of photos with such a tag mostly belong to the pixels as stored: where
    the camera's shape is that of the stored pixels, camera and pose are turned with the photo. Images that are no
    photos here are dropped, with their observations. Raises DataError where sizes contradict each other.
    """
    matched = match_names(poses.names, tuple(photo.name for photo in photos))
    kept = [photo for photo in photos if photo.name in matched]
    if not kept:
        raise DataError(
            f"none of the {len(poses.names)} poses ({', '.join(poses.names[:2])}, ...) names a photo", hint=HINT
        )
    index = np.array([matched[photo.name] for photo in kept], dtype=np.int64)
    cameras: dict[Camera, int] = {}
    ids, rotations, translations = [], poses.rotations[index].copy(), poses.translations[index].copy()
    track_xy = poses.track_xy.copy()
    for i, photo in enumerate(kept):
        camera = poses.camera_of(index[i])
        seen = poses.track_images == index[i]
        for _ in range(_turns(camera, photo)):
            rotations[i], translations[i] = QUARTER_TURN @ rotations[i], QUARTER_TURN @ translations[i]
            track_xy[seen] = np.stack([camera.height - track_xy[seen, 1], track_xy[seen, 0]], axis=1)
            camera = turned(camera)
        track_xy[seen] *= (photo.width / camera.width, photo.height / camera.height)
        ids.append(cameras.setdefault(camera.scaled_to(photo.width, photo.height), len(cameras)))
    new_of_old = np.full(len(poses.names), -1, np.int32)
    new_of_old[index] = np.arange(len(kept))
    images = new_of_old[poses.track_images]
    stays = images >= 0
    return dataclasses.replace(
        poses,
        cameras=tuple(cameras),
        names=tuple(photo.name for photo in kept),
        camera_ids=np.array(ids, dtype=np.int64),
        rotations=rotations,
        translations=translations,
        track_offsets=np.concatenate([[0], np.cumsum(stays)])[poses.track_offsets].astype(np.int64),
        track_images=images[stays],
        track_xy=track_xy[stays],
    )


def turned(camera: Camera) -> Camera:
    """The camera of the same image turned clockwise by a quarter: x' = height - y, y' = x."""
    p = list(camera.params)
    if camera.model in ONE_FOCAL:
        p[1], p[2] = camera.height - p[2], p[1]
    else:
        p[0], p[1], p[2], p[3] = p[1], p[0], camera.height - p[3], p[2]
    if camera.model in ("OPENCV", "FULL_OPENCV"):
        p[6], p[7] = p[7], -p[6]  # tangential terms turn like a vector; radial ones do not change
    return Camera(camera.model, camera.height, camera.width, tuple(p))


def _turns(camera: Camera, photo: Photo) -> int:
    """Clockwise quarter turns from the camera's pixels to the upright photo's."""
    size, upright = (camera.width, camera.height), (photo.original_width, photo.original_height)
    if same_shape(size, photo.stored_size) and photo.orientation in TURNS:
        return TURNS[photo.orientation]
    if same_shape(size, upright) and photo.orientation in (1, 5, 6, 7, 8):
        return 0  # sideways or not a tag at all: the camera was made from the upright pixels
    if same_shape(size, upright):
        raise DataError(f"{photo.name}: mirrored by its EXIF orientation, so that its pose cannot be used", hint=HINT)
    raise DataError(
        f"{photo.name}: the camera of its pose is {size[0]}x{size[1]} px, the photo {upright[0]}x{upright[1]}",
        hint=HINT,
    )
