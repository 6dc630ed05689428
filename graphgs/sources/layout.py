"""What INPUT is: a folder of photos, a COLMAP project, a file of poses, a KITTI or Waymo sequence, a Mill-19 scene.

A folder gives its photos alone: poses found beside them are named, not used, unless INPUT is the pose file itself or
a project whose layout has a place for them (COLMAP's images/ and sparse/, Waymo's ego_pose/, Mill-19's metadata/), so
that "photos without poses" is what a folder of photos means.
"""

import contextlib
import dataclasses
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from graphgs.errors import DataError, UsageError
from graphgs.scene.colmap import find_model, read_model
from graphgs.sources import mill19, waymo
from graphgs.sources.decode import UnusableError, read_header
from graphgs.sources.listing import OUTPUT_MARK, find_masks, holds_photos, list_photos
from graphgs.sources.nuscenes import read_pose_json
from graphgs.sources.photos import Skipped
from graphgs.sources.rigs import LEAST_FRAMES, find_rigs
from graphgs.sources.trajectory import is_kitti, read_calibration
from graphgs.sources.transforms import Transforms

IMAGE_FOLDERS = ("images", "image_2", "image_0", "image_02", "image_00")  # the first that exists; KITTI's after ours
POSE_FILES = ("transforms.json", "transforms_train.json", "poses.txt")
POSE_FOLDERS = {  # what belongs to a project beside its photos
    "waymo": ("ego_pose", "extrinsics", "intrinsics"),
    "mill19": ("train/metadata", "val/metadata"),
}
GREY_TWINS = {"image_0", "image_1", "image_00", "image_01"}  # of KITTI's colour cameras, left out where those are


@dataclass(frozen=True)
class Layout:
    """Where the photos of an input lie and which poses come with them."""

    kind: Literal["photos", "colmap", "transforms", "kitti", "waymo", "mill19"]
    root: Path  # photo names are relative to it
    names: tuple[str, ...]  # candidate photo files, sorted
    refused: tuple[Skipped, ...] = ()  # files that cannot be photos, known from their names
    masks: dict[str, Path] = field(default_factory=dict)  # by photo name
    poses: Path | None = None  # the pose file, or folder of a model or of pose files, in use
    transforms: Transforms | None = None  # what it says, frame by frame; None: it is a COLMAP model or rows of numbers
    note: str = ""  # poses in use, or lying beside the photos unused


def find_layout(source: Path, *, exclude: Path | None = None, rigs: bool = True) -> Layout:
    """Decide what `source` is. `exclude` is a folder below it that holds no input, such as this run's output. With
    `rigs`, folders beside images/ that hold the same frames (images_right/) are cameras of a rig and belong to it."""
    if not source.exists():
        raise UsageError(
            f"{source}: does not exist", hint="INPUT is a folder of photos, or a file of poses beside them"
        )
    if source.is_file():
        return _pose_file(source, exclude)
    model = find_model(source)
    if model == source and not holds_photos(source):
        return _bare_model(source, exclude, rigs)
    if model is not None and (source / "images").is_dir() and (source / "sparse") in (model, model.parent):
        return _photos(source / "images", exclude, kind="colmap", poses=model, note=f"poses from {_short(model)}")
    if waymo.is_waymo(source):
        return _project("waymo", source, exclude, waymo.photo_folders(source), waymo.read_waymo)
    if mill19.is_mill19(source):
        return _project("mill19", source, exclude, mill19.photo_folders(source), mill19.read_mill19)
    root = photo_root(source)
    cameras = _camera_folders(source, root) if rigs and root != source else ()
    if cameras:
        return _photos(source, exclude, only=cameras, note="; ".join(_unused(source, root, cameras)))
    return _photos(root, exclude, note="; ".join(_unused(source, root)))


def photo_root(folder: Path) -> Path:
    """The folder photo names are relative to: `folder`, or images/ in it if photos lie only there."""
    if not holds_photos(folder):
        for name in IMAGE_FOLDERS:
            if (folder / name).is_dir():
                return folder / name
    return folder


def _camera_folders(source: Path, root: Path) -> tuple[str, ...]:
    """Folders in `source`, `root` among them, that are the cameras of one rig by names and sizes; () if there is none.
    Beside images/ only image* count: depth/ and the like hold the same frames too."""
    places = [p for p in sorted(source.iterdir()) if p.name.lower().startswith("image") and holds_photos(p)]
    if root.name not in GREY_TWINS:
        places = [p for p in places if p.name not in GREY_TWINS]
    names, sizes = [], []
    for place in places:
        own = [f"{place.name}/{name}" for name in list_photos(place)[0] if "/" not in name]
        size = _first_size(source, own)
        if size is not None:
            names += own
            sizes += [size] * len(own)
    rigs = find_rigs(tuple(names), np.array(sizes).reshape(-1, 2))
    return next((rig.folders for rig in rigs if root.name in rig.folders), ())


def _first_size(root: Path, names: list[str]) -> tuple[int, int] | None:
    """[px] of the first photo that can be read: files that cannot are named later, by the one decoder."""
    for name in names[:LEAST_FRAMES]:
        try:
            header = read_header(root / name)
        except UnusableError:
            continue
        return header.width, header.height
    return None


def _photos(root: Path, exclude: Path | None, only: tuple[str, ...] = (), **fields) -> Layout:
    """The photos below `root`, or `only` those below some of its folders."""
    names, refused = (), ()
    for folder in only or (".",):
        own, not_own = list_photos(root / folder, exclude=exclude)
        prefix = f"{folder}/" if only else ""
        names += tuple(prefix + name for name in own)
        refused += tuple(Skipped(prefix + skipped.name, skipped.reason) for skipped in not_own)
    if not names:
        more = f" ({len(refused)} files cannot be read, e.g. {refused[0].name}: {refused[0].reason})" if refused else ""
        raise DataError(
            f"{root}: no photos{more}", hint="JPEG, PNG, TIFF, WebP and the like are looked for, recursively"
        )
    return Layout(
        **{"kind": "photos", "masks": find_masks(root, names), **fields}, root=root, names=names, refused=refused
    )


def _unused(source: Path, root: Path, cameras: tuple[str, ...] = ()) -> list[str]:
    """Sentences about poses and photos that lie in `source` and are not used."""
    used = {root.name, *cameras}
    notes = [
        f"{name} lies beside the photos and was not used; give it as INPUT to use its poses"
        for name in POSE_FILES
        if (source / name).is_file()
    ]
    if (source / "calib.txt").is_file():
        with contextlib.suppress(DataError):  # another program's calibration
            focal = read_calibration(source / "calib.txt")[0, 0]
            notes.append(
                f"calib.txt gives a focal length of {focal:.1f} px; --set sources.focal_px={focal:.1f} uses it"
            )
    folders = sorted(p for p in source.iterdir() if p.is_dir() and not p.name.startswith("."))
    models = {find_model(f) for f in [source, *folders] if not (f / OUTPUT_MARK).exists()} - {None}
    for model in sorted(models):
        place = model.relative_to(source).as_posix()
        notes.append(f"{place} holds camera poses and was not used; give it as INPUT to use them")
    if root != source:
        others = [p.name + "/" for p in folders if p.name not in {*used, "masks"} and holds_photos(p)]
        if others:
            here = ", ".join(f"{name}/" for name in sorted(used))
            notes.append(f"photos in {', '.join(others)} were not used, only those in {here}")
    return notes


def _project(kind, source: Path, exclude: Path | None, folders: tuple[str, ...], read) -> Layout:
    """A folder whose layout says where photos and poses lie; names are relative to it."""
    if not folders:
        raise DataError(f"{source}: poses without photos", hint="the photos' folders belong beside them")
    layout = _photos(source, exclude, only=folders, kind=kind)
    transforms = read(source, layout.names)
    note = f"poses from {_short(transforms.path)}"
    return dataclasses.replace(layout, poses=transforms.path, transforms=transforms, note=note)


def _bare_model(model: Path, exclude: Path | None, rigs: bool) -> Layout:
    """A COLMAP model given by itself: its photos lie in images/ of the folder around it, and in the folders beside
    images/ that it names."""
    for folder in list(model.absolute().parents)[:3]:
        if (folder / "images").is_dir():
            fields = {"kind": "colmap", "poses": model, "note": f"poses from {_short(model)}"}
            cameras = _camera_folders(folder, folder / "images") if rigs else ()
            if cameras and {name.partition("/")[0] for name in read_model(model).names} == set(cameras):
                return _photos(folder, exclude, only=cameras, **fields)
            return _photos(folder / "images", exclude, **fields)
    raise DataError(
        f"{model}: a COLMAP model without photos",
        hint="put the photos into images/ beside it, or give a folder of photos",
    )


def _pose_file(file: Path, exclude: Path | None) -> Layout:
    if file.suffix.lower() == ".json":
        return _transforms(file)
    if file.suffix.lower() == ".txt" and is_kitti(file):
        root = photo_root(file.parent)
        return _photos(root, exclude, kind="kitti", poses=file, note=f"poses from {_short(file)}")
    raise UsageError(
        f"{file}: neither a folder of photos nor a file of poses",
        hint="INPUT is a folder of photos, a COLMAP project, a transforms.json, a list in nuScenes' terms "
        "or a KITTI poses.txt",
    )


def _transforms(file: Path) -> Layout:
    """Photos are the frames of the file, a transforms.json or nuScenes' list; names are relative to images/ if all lie
    below it, as for a folder."""
    transforms = read_pose_json(file)
    root = photo_root(file.parent)
    prefix = root.relative_to(file.parent).as_posix() + "/" if root != file.parent else ""
    if not all(frame.name.startswith(prefix) for frame in transforms.frames):
        root, prefix = file.parent, ""
    names, missing, masks = [], [], {}
    for frame in transforms.frames:
        name = frame.name.removeprefix(prefix)
        if not os.path.isfile(root / name):
            missing.append(Skipped(name, f"named in {file.name}, but there is no such file"))
            continue
        names.append(name)
        if frame.mask is not None:
            masks[name] = file.parent / frame.mask
    if not names:
        first = f", e.g. {missing[0].name}" if missing else ""
        raise DataError(
            f"{file}: none of its {len(missing)} photos exists{first}", hint="paths in it are relative to it"
        )
    return Layout(
        kind="transforms",
        root=root,
        names=tuple(sorted(names)),
        refused=tuple(missing),
        masks=find_masks(root, tuple(names)) | masks,
        poses=file,
        transforms=transforms.renamed(prefix),
        note=f"poses from {_short(file)}",
    )


def _short(path: Path) -> str:
    return "/".join(path.absolute().parts[-2:])
