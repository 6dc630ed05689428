"""The true poses of a rendered street, written as inputs come: in several formats, and with the usual mistakes."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np

from graphgs.scene.colmap import write_model
from graphgs.scene.reconstruction import Reconstruction
from graphgs.synth.street import Street

OPENGL = np.diag([1.0, -1.0, -1.0])


def photos_into(street: Street, folder: Path, names: list[str] | None = None) -> list[str]:
    """The street's photos in folder/images, under other names if given; their names."""
    (folder / "images").mkdir(parents=True)
    names = names or list(street.reconstruction.names)
    for old, new in zip(street.reconstruction.names, names, strict=True):
        shutil.copyfile(street.images / old, folder / "images" / new)
    return names


def colmap_project(street: Street, folder: Path, model: Reconstruction | None = None) -> Path:
    photos_into(street, folder)
    write_model(model or street.reconstruction, folder / "sparse" / "0")
    return folder


def transforms_json(
    street: Street,
    folder: Path,
    *,
    axes: str = "opengl",
    inverse: bool = False,
    intrinsics: float = 1.0,  # times the true ones
) -> Path:
    """A transforms.json that says neither width nor height."""
    names = photos_into(street, folder)
    model = street.reconstruction
    flip = OPENGL if axes == "opengl" else np.eye(3)
    frames = []
    for k, name in enumerate(names):
        matrix = np.eye(4)
        if inverse:
            matrix[:3, :3], matrix[:3, 3] = flip @ model.rotations[k], flip @ model.translations[k]
        else:
            matrix[:3, :3], matrix[:3, 3] = model.rotations[k].T @ flip, model.centers[k]
        frames.append({"file_path": f"images/{name}", "transform_matrix": matrix.tolist()})
    fx, fy, cx, cy = (intrinsics * v for v in model.cameras[0].focal_and_center)
    file = folder / "transforms.json"
    file.write_text(json.dumps({"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "frames": frames}))
    return file


def kitti_rows(street: Street, folder: Path, *, padded: bool = True, rows_as_text: bool = False) -> Path:
    """A poses.txt for photos that are numbered in the order of the drive. `rows_as_text`: its rows are sorted as those
    numbers without leading zeros sort as text, 10 before 2."""
    model = street.reconstruction
    count = len(model.names)
    numbers = range(1, count + 1)
    photos_into(street, folder, [f"{k:06d}.jpg" if padded else f"{k}.jpg" for k in numbers])
    rows = [np.column_stack([model.rotations[k].T, model.centers[k]]).ravel() for k in range(count)]
    if rows_as_text:
        rows = [rows[k - 1] for k in sorted(numbers, key=str)]
    np.savetxt(folder / "poses.txt", rows)
    K = model.cameras[0].K
    (folder / "calib.txt").write_text("P0: " + " ".join(map(str, np.column_stack([K, np.zeros(3)]).ravel())) + "\n")
    return folder / "poses.txt"


def with_points_moved(model: Reconstruction) -> Reconstruction:
    """Its points in another frame than its cameras: y and z exchanged, as between z up and y up."""
    return dataclasses.replace(model, points=model.points[:, [0, 2, 1]] * [1, -1, 1] + [3, 1, 0])


def without_tracks(model: Reconstruction) -> Reconstruction:
    """Points alone, as some exporters write them."""
    count = len(model.points)
    return dataclasses.replace(
        model,
        track_offsets=np.zeros(count + 1, np.int64),
        track_images=np.zeros(0, np.int32),
        track_xy=np.zeros((0, 2)),
    )


def written_as_camera_to_world(model: Reconstruction) -> Reconstruction:
    """What a COLMAP model holds when it is given camera-to-world matrices."""
    return dataclasses.replace(model, rotations=model.rotations.transpose(0, 2, 1), translations=model.centers)
