"""The sources stage: from an INPUT to `Photos`."""

import dataclasses
import hashlib
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

import numpy as np

from graphgs.errors import DataError, DiskError, OutOfMemoryError
from graphgs.progress import Reporter
from graphgs.scene.origin import AT_ZERO, near_zero
from graphgs.sources.config import SourcesConfig
from graphgs.sources.decode import (
    MAX_PIXELS,
    Decoded,
    Header,
    UnusableError,
    decode,
    decode_mask,
    decoded_size,
    decoding,
    encode_png,
    open_header,
    read_file,
)
from graphgs.sources.given import fit_to_photos
from graphgs.sources.layout import Layout, find_layout
from graphgs.sources.photos import Photo, Photos, Skipped
from graphgs.sources.poses import axes_in_use, given_poses
from graphgs.sources.rigs import find_rigs

LEAST_PHOTOS = 3  # a scene needs three views
SHOWN = 5  # skipped files spelled out in messages


def load_photos(
    config: SourcesConfig,
    source: Path,
    folder: Path,
    *,
    reporter: Reporter,
    threads: int,
    exclude: Path | None = None,
) -> Photos:
    """Decode the photos of `source` into `folder` and gather what is known about them.

    Single bad files are skipped with a reason. `exclude` is a folder below `source` that is not input, such as the
    run's own output. The same input gives the same files and names for any number of threads.
    Raises UsageError for a missing input, DataError with fewer than 3 usable photos or unusable poses.
    """
    layout = find_layout(source, exclude=exclude, rigs=config.rigs == "auto")
    make_folder(folder / "photos")
    make_folder(folder / "masks")
    with decoding():
        poses = given_poses(layout, config)
        photos, skipped = _decode_all(config, layout, folder, reporter, threads)
    skipped = tuple(sorted((*layout.refused, *skipped), key=lambda s: s.name))
    _check_enough(source, photos, skipped)
    given, origin = near_zero(fit_to_photos(poses, photos)) if poses is not None else (None, AT_ZERO)
    sizes = np.array([(photo.original_width, photo.original_height) for photo in photos])
    rigs = find_rigs(tuple(photo.name for photo in photos), sizes) if config.rigs == "auto" else ()
    result = Photos(folder, photos, skipped, given, layout.note, rigs, origin, axes_in_use(config, layout))
    for file in skipped[:SHOWN]:
        reporter.warn(f"{file.name}: skipped: {file.reason}")
    if len(skipped) > SHOWN:
        reporter.warn(f"{len(skipped) - SHOWN} more files were skipped; the report names them")
    damaged = [photo.name for photo in photos if not photo.exif_readable]
    if damaged:
        reporter.warn(
            f"{len(damaged)} photos have damaged EXIF data and are taken as upright, without focal length: "
            f"{', '.join(damaged[:SHOWN])}"
        )
    if layout.note:
        reporter.info(layout.note)
    for rig in rigs:
        reporter.info(rig.description)
    reporter.event(
        "photos",
        usable=len(photos),
        skipped=len(skipped),
        masks=sum(photo.mask is not None for photo in photos),
        duplicates=sum(len(group) - 1 for group in result.duplicates),
        given=len(given.names) if given is not None else 0,
        rigs=[list(rig.folders) for rig in rigs],
    )
    return result


class PixelBudget:
    """Lets threads decode at once as long as their photos together stay below one photo of the largest size."""

    def __init__(self):
        self._free = MAX_PIXELS
        self._changed = threading.Condition()

    @contextmanager
    def hold(self, pixels: int):
        with self._changed:
            self._changed.wait_for(lambda: self._free >= pixels)
            self._free -= pixels
        try:
            yield
        finally:
            with self._changed:
                self._free += pixels
                self._changed.notify_all()


def _decode_all(
    config: SourcesConfig, layout: Layout, folder: Path, reporter: Reporter, threads: int
) -> tuple[tuple[Photo, ...], list[Skipped]]:
    budget = PixelBudget()
    photos, skipped = [], []
    # Threads, not processes: Pillow and OpenCV decode and encode outside of Python's lock.
    pool = ThreadPoolExecutor(max_workers=threads)
    try:
        jobs = [pool.submit(decode_photo, config, layout, folder, budget, i) for i in range(len(layout.names))]
        for done, (name, job) in enumerate(zip(layout.names, jobs, strict=True), 1):
            try:
                photos.append(job.result())
            except UnusableError as error:
                skipped.append(Skipped(name, str(error)))
            reporter.progress(done, len(jobs), name)
    except MemoryError:
        raise OutOfMemoryError(
            "not enough memory to decode the photos", hint="use fewer --threads, or make the photos smaller"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)
    return tuple(photos), skipped


def decode_photo(config: SourcesConfig, layout: Layout, folder: Path, budget: PixelBudget, index: int) -> Photo:
    """Decode one photo and its mask, write them, and say what is known. Raises UnusableError."""
    name = layout.names[index]
    data = read_file(layout.root / name)
    header = open_header(data)
    with budget.hold(header.width * header.height):
        decoded = decode(data, config.decode_max_side)
        mask = _mask(config, layout, name, decoded)
    photo = describe_photo(config, name, index, header, sha256=hashlib.sha256(data).hexdigest())
    write_file(folder / photo.pixels, encode_png(decoded.pixels))
    if mask is None:
        return photo
    photo = dataclasses.replace(photo, mask=photo.pixels.replace("photos/", "masks/"))
    write_file(folder / photo.mask, encode_png(mask))
    return photo


def describe_photo(config: SourcesConfig, name: str, index: int, header: Header, *, sha256: str = "") -> Photo:
    """What is known of a photo without its pixels; it has no mask yet. `index` counts the layout's names."""
    width, height = decoded_size(header, config.decode_max_side)
    exif = header.exif
    return Photo(
        name=name,
        pixels=f"photos/{index:06d}.png",
        width=width,
        height=height,
        original_width=header.width,
        original_height=header.height,
        mask=None,
        focal_px=config.focal_px * width / header.width if config.focal_px else exif.focal_px(width, height),
        camera_key=f"{PurePosixPath(name).parent}|{header.width}x{header.height}|{exif.camera}",
        sha256=sha256,
        gps=exif.gps,
        time=exif.time,
        exif_readable=exif.readable,
        orientation=exif.orientation,
        focal_given=config.focal_px is not None,
    )


def _mask(config: SourcesConfig, layout: Layout, name: str, decoded: Decoded) -> np.ndarray | None:
    """[H, W] bool, alpha and mask file together; None if every pixel counts."""
    mask = decoded.mask
    if name in layout.masks:
        try:
            drawn = decode_mask(read_file(layout.masks[name]), decoded.header, config.decode_max_side)
        except UnusableError as error:
            raise UnusableError(f"mask {layout.masks[name].name}: {error}") from None
        mask = drawn if mask is None else mask & drawn
    if mask is None or mask.all():
        return None
    if not mask.any():
        raise UnusableError("every pixel is transparent or masked")
    return mask


def _check_enough(source: Path, photos: tuple[Photo, ...], skipped: tuple[Skipped, ...]) -> None:
    if len(photos) >= LEAST_PHOTOS:
        return
    reasons = [f"{s.name} ({s.reason})" for s in skipped[:SHOWN]]
    if len(skipped) > SHOWN:
        reasons.append(f"{len(skipped) - SHOWN} more")
    listing = f"; skipped: {', '.join(reasons)}" if reasons else ""
    raise DataError(
        f"{source}: fewer than {LEAST_PHOTOS} usable photos ({len(photos)}){listing}",
        hint="a scene needs at least 3 photos, better 20 or more, taken from different places and overlapping",
    )


def make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DiskError(f"{folder}: cannot be made: {error.strerror}", hint="choose another OUTPUT") from None


def write_file(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as error:
        raise DiskError(f"{path}: cannot be written: {error.strerror}", hint="free disk space and run again") from None
