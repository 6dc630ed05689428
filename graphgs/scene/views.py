"""Posed, undistorted images: what training and evaluation look at."""

import json
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np


@dataclass(frozen=True)
class Views:
    """Undistorted pinhole views of one scene, sorted by name. Test views never enter a photometric term."""

    folder: Path  # the image and mask files' paths are relative to it
    names: tuple[str, ...]  # [N] photo names
    images: tuple[str, ...]  # [N] 8-bit RGB PNG files
    masks: tuple[str | None, ...]  # [N] 8-bit PNG, 0 = ignore this pixel; None = all count
    sizes: np.ndarray  # [N, 2] int, width and height
    Ks: np.ndarray  # [N, 3, 3] px
    viewmats: np.ndarray  # [N, 4, 4] world-to-camera
    is_test: np.ndarray  # [N] bool
    missing_test: tuple[str, ...] = ()  # test photos that could not be placed

    @property
    def centers(self) -> np.ndarray:
        """[N, 3] camera centres in the world."""
        return -np.einsum("nji,nj->ni", self.viewmats[:, :3, :3], self.viewmats[:, :3, 3])

    def read(self, i: int) -> tuple[np.ndarray, np.ndarray | None]:
        """(image [H, W, 3] uint8 RGB, mask [H, W] bool or None) of view i."""
        image = cv2.imread(str(self.folder / self.images[i]), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if image is None:
            raise OSError(f"{self.folder / self.images[i]}: cannot read the undistorted image")
        mask = None
        if self.masks[i] is not None:
            mask = cv2.imread(str(self.folder / self.masks[i]), cv2.IMREAD_GRAYSCALE)
            if mask is None:
                raise OSError(f"{self.folder / self.masks[i]}: cannot read the mask")
            mask = mask > 127
        return np.ascontiguousarray(image[..., ::-1]), mask

    def save(self, folder: Path) -> None:
        """Write views.npz and views.json; image and mask files must already lie in `folder`."""
        np.savez(folder / "views.npz", sizes=self.sizes, Ks=self.Ks, viewmats=self.viewmats, is_test=self.is_test)
        keys = ("names", "images", "masks", "missing_test")
        (folder / "views.json").write_text(json.dumps({k: list(getattr(self, k)) for k in keys}, indent=1))

    @staticmethod
    def load(folder: Path) -> "Views":
        header = {k: tuple(v) for k, v in json.loads((folder / "views.json").read_text()).items()}
        with np.load(folder / "views.npz", allow_pickle=False) as arrays:
            return Views(folder=folder, **header, **dict(arrays))


class ImageCache:
    """Decoded views kept in memory up to a budget in bytes; the least recently used go first."""

    def __init__(self, views: Views, *, budget_bytes: int):
        self._views = views
        self._budget = budget_bytes
        self._held: OrderedDict[int, tuple[np.ndarray, np.ndarray | None]] = OrderedDict()
        self._bytes = 0

    @property
    def nbytes(self) -> int:
        return self._bytes

    def get(self, i: int) -> tuple[np.ndarray, np.ndarray | None]:
        """(image [H, W, 3] uint8 RGB, mask [H, W] bool or None); do not write into them."""
        if i in self._held:
            self._held.move_to_end(i)
            return self._held[i]
        entry = self._views.read(i)
        self._held[i] = entry
        self._bytes += _nbytes(entry)
        while self._bytes > self._budget and len(self._held) > 1:
            _, old = self._held.popitem(last=False)
            self._bytes -= _nbytes(old)
        return entry


def _nbytes(entry: tuple[np.ndarray, np.ndarray | None]) -> int:
    return entry[0].nbytes + (0 if entry[1] is None else entry[1].nbytes)
