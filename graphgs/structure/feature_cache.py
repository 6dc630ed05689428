"""Features kept by content: they outlive the matching they were made for, and are safe to delete at any time.

A file is named by the hash of what its features were found in (decoded pixels and mask) and of how; so other pairs, a
renamed photo or a photo more or less change nothing about the features of the rest. Files are hard links to those of a
stage's scratch folder where the file system has them: while both are there the disk holds one copy.
"""

import hashlib
import os
from importlib.metadata import version
from pathlib import Path

from graphgs.sources.photos import Photo, Photos
from graphgs.structure.database import link_or_copy

_EXTRACTION = 2  # raise it when the same settings give other features
_LARGEST_BYTES = 4 * 2**30  # features of some 6000 photos at 4096 each; the longest unused go first


class FeatureCache:
    """Files `<SHA-256 of pixels and mask>-<settings>.npz` in one folder."""

    def __init__(self, folder: Path, *, largest_bytes: int = _LARGEST_BYTES):
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._largest_bytes = folder, largest_bytes

    def path(
        self,
        photos: Photos,
        photo: Photo,
        settings: dict[str, int],  # of the extraction
    ) -> Path:
        """Where the features of a photo belong, whether they are there or not."""
        content = hashlib.sha256((photos.folder / photo.pixels).read_bytes())
        content.update(b"" if photo.mask is None else b"\0mask\0" + (photos.folder / photo.mask).read_bytes())
        how = "-".join(f"{settings[name]}" for name in sorted(settings))
        return self._folder / f"{content.hexdigest()[:32]}-{how}-{_EXTRACTION}-{version('pycolmap')}.npz"

    def take(self, cached: Path, target: Path) -> bool:
        """Put the features into `target`; False if there are none."""
        if not cached.exists():
            return False
        os.utime(cached)  # used just now
        target.parent.mkdir(parents=True, exist_ok=True)
        link_or_copy(cached, target)
        return True

    def keep(self, source: Path, cached: Path) -> None:
        """Remember the features in `source`."""
        if source.exists() and not cached.exists():
            partial = cached.with_suffix(".partial")
            partial.unlink(missing_ok=True)
            link_or_copy(source, partial)
            partial.rename(cached)

    def prune(self) -> None:
        """Delete what was used the longest ago, down to the size that the cache may have."""
        files = sorted(((f.stat(), f) for f in self._folder.iterdir() if f.is_file()), key=lambda f: -f[0].st_mtime)
        total = 0
        for stat, file in files:
            total += stat.st_size
            if total > self._largest_bytes:
                file.unlink()
