"""Six kinds of drives and flights with exact truth, made for the scoreboard of shapes; rendered once and kept.

Whether the photos of a kind determine their shape is decided by its geometry: `focal_deviation` of the true cameras
and points, three times which has to stay within what counts as the right focal length. Nothing of it was chosen by
what a reconstruction made of it.
"""

import dataclasses
import functools
import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bench.flights
import bench.lens
import bench.terrain
import graphgs.kernels.raycast
import graphgs.synth
from bench.flights import FlightConfig, write_flight
from bench.shape_information import focal_deviation
from bench.shape_sets import ShapeSet, photos_below
from bench.shape_truth import model_truth
from bench.shape_verdict import FOCAL_LIMIT
from graphgs.progress import Reporter
from graphgs.scene.colmap import read_model
from graphgs.synth import StreetConfig, write_street
from graphgs.synth.drive import UP

SEEDS = (0, 1, 2)
WIDE, NARROW = 85.0, 40.0  # [deg] horizontal field of view
TEXELS = {WIDE: 48.0, NARROW: 80.0}  # per m; a house front ten metres away is about as fine as the photos
CAR = 0.15  # of `StreetConfig.sway`: .1 m aside, .2 degrees up and down
RELIEF = 12.0  # [m] a fifth of the flying height


@dataclass(frozen=True)
class Kind:
    config: Callable[[int], StreetConfig | FlightConfig]  # of a seed
    determined: bool
    why: str


def _drive(course: str, fov_deg: float, *, sway: float, spacing: float) -> Callable[[int], StreetConfig]:
    """40 photos without EXIF data."""

    def config(seed: int) -> StreetConfig:
        return StreetConfig(
            frames=40, width=640, height=360, fov_deg=fov_deg, spacing=spacing, course=course, sway=sway,
            texels_per_m=TEXELS[fov_deg], noise=1.0, depth=False, exif=False, seed=seed,
        )  # fmt: skip

    return config


KINDS = {
    "bend-wide": Kind(
        _drive("bend", WIDE, sway=CAR, spacing=1.0),
        True,
        "turns by 30 degrees: how far the pictures move by a turn tells the focal length",
    ),
    "corner-narrow": Kind(
        _drive("corner", NARROW, sway=CAR, spacing=1.1),
        True,
        "turns by 90 degrees, more than two fields of view",
    ),
    "straight-wide": Kind(
        _drive("straight", WIDE, sway=0.0, spacing=1.0),
        False,
        "never turns: any focal length fits, with a street stretched to match",
    ),
    "straight-narrow": Kind(
        _drive("straight", NARROW, sway=0.0, spacing=1.0),
        False,
        "never turns, and sees little to the sides",
    ),
    "flight-flat": Kind(
        lambda seed: FlightConfig(relief=0.0, seed=seed),
        False,
        "over a plane, straight down within some degrees, a longer focal length and a greater height look alike, and "
        "a lens that bends looks like ground that does",
    ),
    "flight-hilly": Kind(
        lambda seed: FlightConfig(relief=RELIEF, seed=seed),
        True,
        "tilts of 1.5 degrees shift high ground otherwise than low ground, by the focal length",
    ),
}


def synthetic_set(cache: Path, kind: str, seed: int) -> ShapeSet:
    """The photos and the truth of a kind and a seed, made unless they are there."""
    made, config = KINDS[kind], KINDS[kind].config(seed)
    wanted = json.dumps(dataclasses.asdict(config), sort_keys=True)
    version = hashlib.sha256((wanted + _renderer(type(config))).encode()).hexdigest()[:12]
    folder = cache / "shape_sets" / f"{kind}_{seed}_{version}"
    if not folder.exists():
        partial = folder.with_name(folder.name + ".partial")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        if isinstance(config, FlightConfig):
            write_flight(config, partial)
        else:
            write_street(config, partial, reporter=Reporter())
        known_to = focal_deviation(read_model(partial / "truth"))
        (partial / "focal_known_to.json").write_text(json.dumps(known_to if known_to < 1e3 else None))
        partial.rename(folder)
    known_to = json.loads((folder / "focal_known_to.json").read_text())
    known_to = float("inf") if known_to is None else known_to
    if made.determined != (3 * known_to < FOCAL_LIMIT):
        raise AssertionError(
            f"{kind}, seed {seed}: said to be determined: {made.determined}; focal +- {known_to:.2f} %"
        )
    up = UP if isinstance(config, FlightConfig) else None
    truth = model_truth(read_model(folder / "truth"), up=up)
    return ShapeSet(
        f"{kind}-{seed}", folder / "images", photos_below(folder / "images"), truth,
        determined=made.determined, focal_known_to=known_to,
    )  # fmt: skip


@functools.cache
def _renderer(config: type) -> str:
    """A hash of the code that the photos depend on."""
    content = hashlib.sha256()
    packages = [Path(module.__file__).parent for module in (graphgs.synth, graphgs.kernels.raycast)]
    files = [path for package in packages for path in package.glob("*.py")]
    if config is FlightConfig:
        files += [Path(module.__file__) for module in (bench.flights, bench.lens, bench.terrain)]
    for path in sorted(files):
        content.update(path.read_bytes())
    return content.hexdigest()
