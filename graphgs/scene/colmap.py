"""COLMAP models, read and written without pycolmap.

Foreign files get bounds of our own: every count is held against the bytes that are there before anything is
allocated (a truncated points3D.bin makes COLMAP's own reader allocate without bound, and a short cameras.bin loads
silently). Formats: https://colmap.github.io/format.html; newer models' rigs and frames files repeat what
images.bin says and are not read.
"""

import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from graphgs.errors import DataError
from graphgs.scene.camera import MODEL_PARAMS, Camera
from graphgs.scene.names import inside
from graphgs.scene.reconstruction import Reconstruction

MODEL_NAMES = tuple(MODEL_PARAMS)  # COLMAP's model ids 0..6 are the positions in this table
PLACES = (".", "sparse/0", "sparse", "colmap/sparse/0")  # where a model is looked for below a folder
POINT2D = np.dtype([("xy", "<f8", 2), ("point", "<i8")])
REEXPORT = "export the model again with COLMAP (colmap model_converter), or leave it out"


@dataclass
class _Model:
    """A model as its files say it, before ids become indices."""

    cameras: dict[int, Camera] = field(default_factory=dict)
    images: list[tuple[str, int, int, tuple[float, ...], np.ndarray]] = field(default_factory=list)
    """name, image id, camera id, (qw qx qy qz tx ty tz), 2D points [n, 2] px"""
    points: list[tuple[int, tuple[float, ...], np.ndarray]] = field(default_factory=list)
    """point id, (x y z r g b error), track [n, 2] of image id and index of the 2D point"""


def find_model(folder: Path) -> Path | None:
    """The folder that holds a COLMAP model: `folder` itself or one of its usual places, else None.

    Of the numbered models COLMAP leaves in sparse/ the one with the largest images file is taken: model 0 can be
    a scrap while model 1 holds everything.
    """
    numbered = sorted((p for p in (folder / "sparse").glob("[0-9]*") if _images_file(p)), key=lambda p: p.name)
    numbered.sort(key=lambda p: -_images_file(p).stat().st_size)
    places = [folder, *numbered, *(folder / place for place in PLACES[1:])]
    return next((p for p in places if _images_file(p)), None)


def _images_file(folder: Path) -> Path | None:
    for suffix in (".bin", ".txt"):
        if (folder / f"cameras{suffix}").is_file() and (folder / f"images{suffix}").is_file():
            return folder / f"images{suffix}"
    return None


def read_model(folder: Path) -> Reconstruction:
    """The COLMAP model (binary or text) in `folder` or its usual places; images sorted by name, points by id.

    2D points without a 3D point are dropped. Raises DataError for files that are missing, cut short, or not a model.
    """
    place = find_model(folder)
    if place is None:
        raise DataError(
            f"{folder}: no COLMAP model (cameras and images, .bin or .txt)",
            hint=f"a model is looked for in the folder itself and in {', '.join(PLACES[1:])}",
        )
    model = _read_binary(place) if _images_file(place).suffix == ".bin" else _read_text(place)
    return _assemble(model, place)


# ---------------------------------------------------------------- reading bytes


class _Bytes:
    """A binary file read front to back, never past its end."""

    def __init__(self, path: Path):
        self.path, self.data, self.at = path, path.read_bytes(), 0

    def take(self, size: int, what: str) -> int:
        """Offset of the next `size` bytes."""
        start = self.at
        if size > len(self.data) - start:
            raise DataError(
                f"{self.path}: cut short or not a COLMAP file: "
                f"{what} needs {size} bytes, {len(self.data) - start} are left",
                hint=REEXPORT,
            )
        self.at = start + size
        return start

    def unpack(self, form: struct.Struct, what: str) -> tuple:
        return form.unpack_from(self.data, self.take(form.size, what))

    def count(self, smallest: int, what: str) -> int:
        """A count of records of at least `smallest` bytes each."""
        (n,) = self.unpack(_COUNT, f"the number of {what}")
        if n * smallest > len(self.data) - self.at:
            self.take(n * smallest, f"{n} {what}")
        return n

    def array(self, dtype: np.dtype, n: int, what: str) -> np.ndarray:
        return np.frombuffer(self.data, dtype, n, self.take(n * dtype.itemsize, what))

    def name(self, what: str) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            self.take(len(self.data), f"the name of {what}")
        raw, self.at = self.data[self.at : end], end + 1
        return raw.decode("utf-8", errors="surrogateescape")

    def finish(self) -> None:
        if self.at != len(self.data):
            surplus = len(self.data) - self.at
            raise DataError(f"{self.path}: {surplus} bytes too many after the last record", hint=REEXPORT)


_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<IiQQ")
_IMAGE = struct.Struct("<I7dI")
_POINT = struct.Struct("<Q3d3Bd")
_TRACK = np.dtype(("<u4", 2))


def _read_binary(folder: Path) -> _Model:
    model = _Model()
    file = _Bytes(folder / "cameras.bin")
    for _ in range(file.count(_CAMERA.size, "cameras")):
        key, kind, width, height = file.unpack(_CAMERA, "a camera")
        name = MODEL_NAMES[kind] if 0 <= kind < len(MODEL_NAMES) else f"number {kind}"
        params = file.array(np.dtype("<f8"), MODEL_PARAMS.get(name, 0), "a camera's parameters")
        _add_camera(model, file.path, key, name, width, height, params)
    file.finish()

    file = _Bytes(folder / "images.bin")
    for _ in range(file.count(_IMAGE.size + 9, "images")):
        key, *pose, camera = file.unpack(_IMAGE, "an image")
        name = file.name(f"image {key}")
        xy = file.array(POINT2D, file.count(POINT2D.itemsize, "2D points"), f"the 2D points of image {key}")["xy"]
        model.images.append((name, key, camera, tuple(pose), xy))
    file.finish()

    if (folder / "points3D.bin").is_file():
        file = _Bytes(folder / "points3D.bin")
        for _ in range(file.count(_POINT.size + 8, "points")):
            key, *values = file.unpack(_POINT, "a point")
            track = file.array(_TRACK, file.count(8, "observations"), f"the track of point {key}")
            model.points.append((key, tuple(values), track))
        file.finish()
    return model


# ---------------------------------------------------------------- reading text


class _Lines:
    """The lines of a text file without comments; blank ones stay, they may be an image without points."""

    def __init__(self, path: Path):
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            raise DataError(f"{path}: not a text file", hint=REEXPORT) from None
        self.path, self.number = path, 0
        self._lines = enumerate(text.splitlines(), 1)

    def __iter__(self):
        return self

    def __next__(self) -> str:
        line = "#"
        while line.startswith("#"):
            self.number, line = next(self._lines)
            line = line.strip()
        return line


def _read_text(folder: Path) -> _Model:
    model = _Model()
    for name, parse in _PARSERS.items():
        if name == "points3D" and not (folder / "points3D.txt").is_file():
            continue  # poses alone
        lines = _Lines(folder / f"{name}.txt")
        try:
            for line in filter(None, lines):
                parse(model, line, lines)
        except (ValueError, OverflowError) as error:
            raise DataError(
                f"{lines.path}, line {lines.number}: not a line of a COLMAP model ({error})", hint=REEXPORT
            ) from None
    return model


def _parse_camera(model: _Model, line: str, lines: _Lines) -> None:
    key, name, width, height, *params = line.split()
    _add_camera(model, lines.path, int(key), name, int(width), int(height), [float(p) for p in params])


def _parse_image(model: _Model, line: str, lines: _Lines) -> None:
    key, *pose, camera, name = line.split(maxsplit=9)
    xy = np.array(next(lines, "").split(), dtype=np.float64).reshape(-1, 3)[:, :2]
    model.images.append((name, int(key), int(camera), tuple(float(v) for v in pose), xy))


def _parse_point(model: _Model, line: str, lines: _Lines) -> None:
    key, x, y, z, r, g, b, error, *track = line.split()
    values = (float(x), float(y), float(z), int(r), int(g), int(b), float(error))
    model.points.append((int(key), values, np.array(track, dtype=np.int64).reshape(-1, 2)))


_PARSERS = {"cameras": _parse_camera, "images": _parse_image, "points3D": _parse_point}


# ---------------------------------------------------------------- from ids to indices


def _add_camera(model: _Model, path: Path, key: int, name: str, width: int, height: int, params) -> None:
    if name not in MODEL_PARAMS:
        raise DataError(
            f"{path}: camera {key} has the model {name}, which is not supported",
            hint=f"undistort with `colmap image_undistorter`, or convert to one of {', '.join(MODEL_PARAMS)}",
        )
    try:
        model.cameras[key] = Camera(name, width, height, tuple(params))
    except ValueError as error:
        raise DataError(f"{path}: camera {key}: {error}", hint=REEXPORT) from None


def _assemble(model: _Model, folder: Path) -> Reconstruction:
    def wrong(what: str) -> DataError:
        return DataError(f"{folder}: {what}", hint=REEXPORT)

    images = []
    for name, key, camera, pose, xy in model.images:
        if inside(name) is None:
            raise wrong(f"image {key} has the name {name!a}, which is not a path inside the photo folder")
        if camera not in model.cameras:
            raise wrong(f"image {name!a} uses camera {camera}, which cameras does not list")
        if len(pose) != 7 or not np.isfinite(pose).all() or not 1e-6 < np.abs(pose[:4]).max() < 1e6:
            raise wrong(f"image {name!a} has no valid pose")
        images.append((inside(name), key, camera, pose, xy))
    if not images:
        raise wrong("the model holds no images")
    images.sort(key=lambda image: image[0])
    names, ids, cameras, poses, xys = zip(*images, strict=True)
    if len(set(names)) < len(names) or len(set(ids)) < len(ids):
        raise wrong("two images share a name or an id")
    camera_keys = sorted(set(cameras))
    poses = np.array(poses, dtype=np.float64).reshape(-1, 7)

    points = sorted(model.points, key=lambda point: point[0])
    if len({p[0] for p in points}) < len(points):
        raise wrong("two points share an id")
    values = np.array([p[1] for p in points], dtype=np.float64).reshape(-1, 7)
    if not np.isfinite(values[:, :3]).all():
        raise wrong("a point has no finite position")
    if (values[:, 3:6] < 0).any() or (values[:, 3:6] > 255).any():
        raise wrong("a point has a colour outside 0..255")
    offsets, track_images, track_xy = _tracks([p[2] for p in points], np.array(ids, dtype=np.int64), xys, wrong)
    return Reconstruction(
        cameras=tuple(model.cameras[key] for key in camera_keys),
        names=names,
        camera_ids=np.searchsorted(camera_keys, cameras).astype(np.int64),
        rotations=Rotation.from_quat(poses[:, [1, 2, 3, 0]]).as_matrix().reshape(-1, 3, 3),
        translations=poses[:, 4:],
        points=values[:, :3],
        colors=values[:, 3:6].astype(np.uint8),
        errors=np.where(np.isfinite(values[:, 6]), values[:, 6], -1.0),  # COLMAP: -1 is "not computed"
        track_offsets=offsets,
        track_images=track_images,
        track_xy=track_xy,
    )


def _tracks(tracks: list[np.ndarray], image_ids: np.ndarray, xys: tuple[np.ndarray, ...], wrong):
    """(offsets [P + 1], image index [T], px [T, 2]) of the points' tracks."""
    observed = np.concatenate([*xys, np.zeros((0, 2))])
    if len(observed) == 0:  # poses and points without 2D points, as some exporters write: nothing to look up
        tracks = [track[:0] for track in tracks]
    offsets = np.concatenate([[0], np.cumsum([len(track) for track in tracks], dtype=np.int64)]).astype(np.int64)
    flat = np.concatenate([*tracks, np.zeros((0, 2), np.int64)]).astype(np.int64).reshape(-1, 2)
    if len(flat) == 0:
        return offsets, np.zeros(0, np.int32), np.zeros((0, 2))
    order = np.argsort(image_ids)
    image = order[np.searchsorted(image_ids, flat[:, 0], sorter=order).clip(max=len(order) - 1)]
    if (image_ids[image] != flat[:, 0]).any():
        raise wrong("a track names an image that images does not list")
    sizes = np.array([len(xy) for xy in xys])
    if (flat[:, 1] < 0).any() or (flat[:, 1] >= sizes[image]).any():
        raise wrong("a track names a 2D point that its image does not have")
    starts = np.concatenate([[0], np.cumsum(sizes)])
    return offsets, image.astype(np.int32), observed[starts[image] + flat[:, 1]]


# ---------------------------------------------------------------- writing


def write_model(reconstruction: Reconstruction, folder: Path, *, names: tuple[str, ...] | None = None) -> None:
    """Write cameras.bin, images.bin and points3D.bin into `folder`, ids counted from 1.

    `names` [N] replaces the image names, e.g. by the file names of undistorted copies.
    """
    names = reconstruction.names if names is None else names
    if len(names) != len(reconstruction.names):
        raise ValueError(f"names: expected {len(reconstruction.names)}, got {len(names)}")
    folder.mkdir(parents=True, exist_ok=True)

    with open(folder / "cameras.bin", "wb") as file:
        file.write(_COUNT.pack(len(reconstruction.cameras)))
        for key, camera in enumerate(reconstruction.cameras, 1):
            file.write(_CAMERA.pack(key, MODEL_NAMES.index(camera.model), camera.width, camera.height))
            file.write(np.array(camera.params, "<f8").tobytes())

    lengths = reconstruction.track_lengths
    point_of = np.repeat(np.arange(1, len(lengths) + 1), lengths)  # [T] point id of every observation
    by_image = np.argsort(reconstruction.track_images, kind="stable")
    starts = np.searchsorted(reconstruction.track_images[by_image], np.arange(len(names) + 1))
    tracks = np.empty((len(by_image), 2), "<u4")  # [T] image id, index among that image's 2D points
    tracks[:, 0] = reconstruction.track_images + 1
    tracks[by_image, 1] = np.arange(len(by_image)) - starts[reconstruction.track_images[by_image]]

    quats = Rotation.from_matrix(reconstruction.rotations).as_quat(canonical=True) if names else np.zeros((0, 4))
    with open(folder / "images.bin", "wb") as file:
        file.write(_COUNT.pack(len(names)))
        for i, name in enumerate(names):
            pose = (*np.roll(quats[i], 1), *reconstruction.translations[i])
            file.write(_IMAGE.pack(i + 1, *pose, int(reconstruction.camera_ids[i]) + 1))
            file.write(name.encode("utf-8") + b"\0")
            seen = by_image[starts[i] : starts[i + 1]]
            points2d = np.empty(len(seen), POINT2D)
            points2d["xy"], points2d["point"] = reconstruction.track_xy[seen], point_of[seen]
            file.write(_COUNT.pack(len(seen)) + points2d.tobytes())

    with open(folder / "points3D.bin", "wb") as file:
        file.write(_COUNT.pack(len(lengths)))
        for p, start in enumerate(reconstruction.track_offsets[:-1]):
            track = tracks[start : start + lengths[p]]
            color = reconstruction.colors[p].tolist()
            file.write(_POINT.pack(p + 1, *reconstruction.points[p], *color, reconstruction.errors[p]))
            file.write(_COUNT.pack(len(track)) + track.tobytes())
