"""Which files of a folder are photos. Names never leave the folder; what cannot be a photo is left out or named."""

import os
from pathlib import Path

from graphgs.errors import UsageError
from graphgs.scene.names import printable
from graphgs.sources.photos import Skipped

SUFFIXES = {".jpg", ".jpeg", ".jpe", ".png", ".tif", ".tiff", ".webp", ".bmp", ".ppm", ".pgm", ".pnm", ".gif"}
SUFFIXES |= {".jp2", ".j2k", ".avif", ".mpo"}
HEIC = {".heic", ".heif"}
RAW = {".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2"}
IGNORED_FOLDERS = {"__macosx", "@eadir", "thumbnails", "thumbnail", "thumbs", "masks"}
OUTPUT_MARK = "run.toml"  # a folder that holds it is the output of an earlier run, not photos


def list_photos(root: Path, *, exclude: Path | None = None) -> tuple[tuple[str, ...], tuple[Skipped, ...]]:
    """(names of photo files below `root`, sorted; files that look like photos but cannot be read, with the reason).

    Hidden files, thumbnails, masks, outputs of earlier runs and the folder `exclude` are left out. Links are
    followed, each folder once.
    """
    names, refused = [], []
    seen = {exclude.resolve()} if exclude else set()
    for folder, children, files in os.walk(root, followlinks=True, onerror=_refuse):
        place = Path(folder)
        if place.resolve() in seen or (OUTPUT_MARK in files and place != root):
            children.clear()
            continue
        seen.add(place.resolve())
        children[:] = sorted(c for c in children if not c.startswith(".") and c.lower() not in IGNORED_FOLDERS)
        for file in sorted(files):
            suffix = os.path.splitext(file)[1].lower()
            if file.startswith(".") or suffix not in SUFFIXES | HEIC | RAW:
                continue
            name = (place / file).relative_to(root).as_posix()
            if suffix in HEIC:
                refused.append(Skipped(_shown(name), "HEIC is not supported; convert it to JPEG"))
            elif suffix in RAW:
                refused.append(Skipped(_shown(name), "camera raw is not supported; export it as JPEG or TIFF"))
            elif not printable(name):
                refused.append(Skipped(_shown(name), "its name holds control or undecodable characters; rename it"))
            else:
                names.append(name)
    return tuple(sorted(names)), tuple(sorted(refused, key=lambda skipped: skipped.name))


def holds_photos(folder: Path) -> bool:
    """True if photo files lie directly in `folder`."""
    try:
        return any(os.path.splitext(f)[1].lower() in SUFFIXES and not f.startswith(".") for f in os.listdir(folder))
    except OSError:
        return False


def find_masks(root: Path, names: tuple[str, ...]) -> dict[str, Path]:
    """Mask files by photo name: a/b.jpg has masks/a/b.png or masks/a/b.jpg.png, with masks/ in or beside `root`."""
    places = [place for place in (root / "masks", root.parent / "masks") if place.is_dir()]
    found = {}
    for name in names:
        spellings = (os.path.splitext(name)[0] + ".png", name + ".png")
        for candidate in (place / spelling for place in places for spelling in spellings):
            if candidate.is_file():
                found[name] = candidate
                break
    return found


def _shown(name: str) -> str:
    return name if printable(name) else name.encode("unicode_escape").decode()


def _refuse(error: OSError) -> None:
    raise UsageError(
        f"{error.filename}: cannot be listed: {error.strerror}", hint="check that you may read this folder"
    ) from None
