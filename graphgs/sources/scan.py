"""Quick looks at an INPUT that decode nothing: what `graphgs check` lists, and the key of the sources stage."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.sources.decode import UnusableError, decoding, read_header
from graphgs.sources.layout import POSE_FOLDERS, find_layout
from graphgs.sources.photos import Skipped
from graphgs.sources.rigs import Rig, find_rigs


@dataclass(frozen=True)
class Scan:
    """What a quick look at an input shows: headers only, nothing decoded."""

    kind: str  # photos, colmap, transforms, kitti, waymo or mill19
    root: Path  # names are relative to it
    names: tuple[str, ...]  # photos whose header is sound, sorted
    sizes: np.ndarray  # [N, 2] int, px, upright
    skipped: tuple[Skipped, ...]
    masks: int  # photos with a mask file
    note: str  # poses in use, or lying beside the photos unused
    rigs: tuple[Rig, ...]  # cameras that seem to have moved together


def scan(source: Path, *, exclude: Path | None = None, rigs: bool = True) -> Scan:
    """List the photos of `source` by their headers. Raises like `load_photos` for what can be seen without decoding."""
    layout = find_layout(source, exclude=exclude, rigs=rigs)
    names, sizes, skipped = [], [], list(layout.refused)
    with decoding():
        for name in layout.names:
            try:
                header = read_header(layout.root / name)
            except UnusableError as error:
                skipped.append(Skipped(name, str(error)))
                continue
            names.append(name)
            sizes.append((header.width, header.height))
    extents = np.array(sizes, dtype=np.int64).reshape(-1, 2)
    return Scan(
        kind=layout.kind,
        root=layout.root,
        names=tuple(names),
        sizes=extents,
        skipped=tuple(sorted(skipped, key=lambda s: s.name)),
        masks=len(layout.masks),
        note=layout.note,
        rigs=find_rigs(tuple(names), extents) if rigs else (),
    )


def fingerprint(source: Path, *, exclude: Path | None = None, rigs: bool = True, quick: bool = False) -> str:
    """SHA-256 over names and contents of all files the input consists of: the key of the sources stage.

    `quick` takes sizes and modification times instead of contents: it changes more often than the contents do, but
    costs no reading.
    """
    layout = find_layout(source, exclude=exclude, rigs=rigs)
    files = {f"photo {name}": layout.root / name for name in layout.names}
    files |= {f"mask {name}": path for name, path in layout.masks.items()}
    if layout.poses is not None:
        beside = layout.poses.parent / "calib.txt" if layout.kind == "kitti" else None
        inside = sorted(layout.poses.iterdir()) if layout.poses.is_dir() else [layout.poses]
        files |= {f"poses {path.name}": path for path in [*inside, beside] if path is not None and path.is_file()}
    for place in POSE_FOLDERS.get(layout.kind, ()):
        own = sorted((layout.root / place).glob("*"))
        files |= {f"poses {place}/{path.name}": path for path in own if path.is_file()}
    total = hashlib.sha256(layout.kind.encode())
    for refused in layout.refused:
        total.update(f"\0{refused.name}\0{refused.reason}".encode())
    for label in sorted(files):
        total.update(f"\0{label}\0{_digest(files[label], quick)}".encode())
    return total.hexdigest()


def _digest(path: Path, quick: bool) -> str:
    try:
        if quick:
            status = path.stat()
            return f"{status.st_size} {status.st_mtime_ns}"
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return "unreadable"
