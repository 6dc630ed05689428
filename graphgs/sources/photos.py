"""The artefact of the sources stage: decoded photos and what is known about them."""

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.scene.origin import AT_ZERO, Origin
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.rigs import Rig

TEST_EVERY = 8  # every 8th photo by name is held out (the field's split since Mip-NeRF 360)


@dataclass(frozen=True)
class Photo:
    """One readable photo, decoded to 8-bit RGB, turned upright, at most `decode_max_side` long."""

    name: str  # POSIX path relative to the input folder: the identity of the image
    pixels: str  # decoded PNG, relative to the artefact folder
    width: int  # [px] of the decoded image
    height: int
    original_width: int  # [px] of the file, after EXIF rotation
    original_height: int
    mask: str | None  # PNG of the decoded size, 0 = ignore; None = every pixel counts
    focal_px: float | None  # [px] at the decoded size, from EXIF or a setting
    camera_key: str  # photos of equal key share their intrinsics
    sha256: str  # of the original file
    gps: tuple[float, float, float] | None  # latitude, longitude [deg, WGS84], altitude [m, 0 if not given]
    time: float | None  # [s] the camera's own clock at capture, read as if it were UTC
    exif_readable: bool = True  # False: damaged EXIF, so taken as upright, without focal length and position
    orientation: int = 1  # EXIF orientation the file had; the decoded pixels are upright
    focal_given: bool = False  # the focal length is from a setting: exact, where EXIF rounds

    @property
    def stored_size(self) -> tuple[int, int]:
        """[px] (width, height) of the file's pixels as stored, before EXIF rotation."""
        size = (self.original_width, self.original_height)
        return size[::-1] if self.orientation >= 5 else size


@dataclass(frozen=True)
class Skipped:
    """A file that could not be used, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class Photos:
    """All readable photos of an input, sorted by name."""

    folder: Path  # `pixels` and `mask` of the photos are relative to it
    photos: tuple[Photo, ...]
    skipped: tuple[Skipped, ...] = ()
    given: Reconstruction | None = None  # poses the input carries; cameras at the decoded size, names = photo names
    given_note: str = ""  # where `given` comes from, or which poses lie beside the photos and were not used
    rigs: tuple[Rig, ...] = ()  # cameras that seem to have moved together
    origin: Origin = AT_ZERO  # of `given`, in the frame of the input
    given_axes: str = "opencv"  # opencv or opengl: the camera axes that `given` was read with

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(photo.name for photo in self.photos)

    @property
    def is_test(self) -> np.ndarray:
        """[N] bool, held out from training."""
        return np.arange(len(self.photos)) % TEST_EVERY == 0

    @property
    def duplicates(self) -> tuple[tuple[str, ...], ...]:
        """Names of photos whose files are byte for byte the same, one group each."""
        groups: dict[str, list[str]] = {}
        for photo in self.photos:
            groups.setdefault(photo.sha256, []).append(photo.name)
        return tuple(tuple(names) for names in groups.values() if len(names) > 1)

    def save(self, folder: Path) -> None:
        """Write photos.json and given/; the image files must already lie in `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        if self.given is not None:
            self.given.save(folder / "given")
        header = {
            "photos": [dataclasses.asdict(photo) for photo in self.photos],
            "skipped": [dataclasses.asdict(skipped) for skipped in self.skipped],
            "given": self.given is not None,
            "given_note": self.given_note,
            "origin": self.origin,
            "given_axes": self.given_axes,
            "rigs": [{"folders": rig.folders, "photos": rig.photos.tolist()} for rig in self.rigs],
        }
        (folder / "photos.json").write_text(json.dumps(header, indent=1))

    @staticmethod
    def load(folder: Path) -> "Photos":
        header = json.loads((folder / "photos.json").read_text())
        photos = [Photo(**{**p, "gps": tuple(p["gps"]) if p["gps"] else None}) for p in header["photos"]]
        return Photos(
            folder=folder,
            photos=tuple(photos),
            skipped=tuple(Skipped(**s) for s in header["skipped"]),
            given=Reconstruction.load(folder / "given") if header["given"] else None,
            given_note=header["given_note"],
            rigs=tuple(Rig(tuple(r["folders"]), np.array(r["photos"], dtype=np.int64)) for r in header["rigs"]),
            origin=tuple(header.get("origin", AT_ZERO)),  # older ones have none
            given_axes=header.get("given_axes", "opencv"),
        )
