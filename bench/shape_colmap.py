"""COLMAP as it comes: SIFT of every photo, all pairs matched, the incremental mapper. Made once per photo set.

The defaults of pycolmap are kept throughout: 8192 features of at most 3200 px, a SIMPLE_RADIAL camera whose focal
length comes from the photos' EXIF data or is guessed, refined with its distortion. Ours takes photos of one folder
and one size as one camera, so COLMAP does too. Only the number of threads is set, to one.

Each of the three steps runs in a process of its own (`python -m bench.shape_colmap STEP ...`), so that its processor
seconds are known. A step that was killed is repeated; matching, which takes hours for some sets, continues.
"""

import hashlib
import json
import shutil
import sys
import threading
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, ImageOps

from bench.child_process import run_module
from graphgs.scene.colmap import read_model
from graphgs.scene.reconstruction import Reconstruction

STEPS = ("features", "matches", "models")
ORIENTATION = 0x0112
SEED = 0
SPENT, NOTE_EVERY_S = "matches_spent.json", 5.0


@dataclass(frozen=True)
class ColmapResult:
    model: Reconstruction | None  # of its models the one with most photos; None where it found none
    cpu_s: float


def colmap_result(
    cache: Path,
    name: str,
    images: Path,  # folder; photos in folders below it are other cameras
    photos: tuple[str, ...],  # names below `images`, those that ours is given
) -> ColmapResult:
    """COLMAP's model of these photos, from the cache unless it has to be made."""
    folder = cache / "colmap" / f"{name}_{fingerprint(images, photos)}"
    upright(images, photos, folder / "images")
    spent = sum(_step(folder, step) for step in STEPS)
    models = [read_model(place) for place in sorted((folder / "models").iterdir()) if place.is_dir()]
    return ColmapResult(max(models, key=lambda model: len(model.names), default=None), spent)


def upright(images: Path, photos: tuple[str, ...], target: Path) -> None:
    """The photos as ours decodes them: COLMAP does not turn a photo as its EXIF orientation says, so such a photo is
    turned for it; all others are links to the very files."""
    for name in photos:
        copy = target / name
        if copy.is_symlink():
            copy.unlink()  # the photos may lie elsewhere by now
        elif copy.exists():
            continue
        copy.parent.mkdir(parents=True, exist_ok=True)
        with Image.open(images / name) as photo:
            exif = photo.getexif()
            if exif.get(ORIENTATION, 1) == 1:
                copy.symlink_to((images / name).resolve())
                continue
            turned = ImageOps.exif_transpose(photo)
            options = {"quality": 98, "subsampling": 0} if copy.suffix.lower() in (".jpg", ".jpeg") else {}
            turned.save(copy, exif=turned.getexif(), **options)  # all but the orientation


def _step(folder: Path, step: str) -> float:
    """Processor seconds of one step, made unless it is there: STEP.json is written last."""
    record = folder / f"{step}.json"
    if not record.is_file():
        earlier = _spent_earlier(folder) if step == "matches" else 0.0
        ended = run_module("bench.shape_colmap", [step, str(folder)], log=folder / f"{step}.log")
        if ended.returncode != 0:
            raise RuntimeError(f"COLMAP's {step} ended with {ended.returncode}: read {folder / f'{step}.log'}")
        record.write_text(json.dumps({"cpu_s": earlier + ended.cpu_s}) + "\n")
    return json.loads(record.read_text())["cpu_s"]


def _spent_earlier(folder: Path) -> float:
    """Processor seconds of matching in runs that were killed; their matches stay."""
    spent = folder / SPENT
    return json.loads(spent.read_text())["cpu_s"] if spent.is_file() else 0.0


def fingerprint(images: Path, photos: tuple[str, ...]) -> str:
    """Of the photos' names and bytes and of COLMAP: what its results depend on."""
    import pycolmap

    content = hashlib.sha256(pycolmap.__version__.encode())
    for name in photos:
        content.update(name.encode())
        content.update((images / name).read_bytes())
    return content.hexdigest()[:12]


# ---------------------------------------------------------------- in the child


def extract(folder: Path) -> None:
    import pycolmap

    database = folder / "features.db"
    database.unlink(missing_ok=True)
    cameras = defaultdict(list)
    images = folder / "images"
    for path in sorted(path for path in images.rglob("*") if path.is_file()):
        with Image.open(path) as photo:
            cameras[path.parent, photo.size].append(path.relative_to(images).as_posix())
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = 1
    for names in cameras.values():  # a call makes one camera
        pycolmap.extract_features(
            database, images, image_names=names, camera_mode=pycolmap.CameraMode.SINGLE, extraction_options=options
        )


def match(folder: Path) -> None:
    """COLMAP skips the pairs that the database holds already."""
    import pycolmap

    database, partial = folder / "matches.db", folder / "matches.partial"
    if not database.is_file():
        shutil.copyfile(folder / "features.db", partial)
        partial.rename(database)
    threading.Thread(target=_note_spent, args=(folder, _spent_earlier(folder)), daemon=True).start()
    options = pycolmap.FeatureMatchingOptions()
    options.num_threads = 1
    pycolmap.match_exhaustive(database, matching_options=options)


def _note_spent(folder: Path, earlier: float) -> None:
    """Every few seconds, how long matching has taken in all: a kill loses no more of it."""
    while True:
        time.sleep(NOTE_EVERY_S)
        partial = folder / f"{SPENT}.partial"
        partial.write_text(json.dumps({"cpu_s": earlier + time.process_time()}))
        partial.rename(folder / SPENT)


def make_models(folder: Path) -> None:
    import pycolmap

    shutil.rmtree(folder / "models", ignore_errors=True)
    (folder / "models").mkdir()
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    pycolmap.incremental_mapping(folder / "matches.db", folder / "images", folder / "models", options=options)


def main(step: str, folder: str) -> None:
    import pycolmap

    pycolmap.set_random_seed(SEED)
    dict(zip(STEPS, (extract, match, make_models), strict=True))[step](Path(folder))


if __name__ == "__main__":
    main(*sys.argv[1:])
