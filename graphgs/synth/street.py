"""`graphgs synth street`: photos of a procedural street with exact poses and depths."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from PIL import Image

from graphgs.errors import DiskError
from graphgs.kernels.raycast import raycast
from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.colmap import write_model
from graphgs.scene.reconstruction import Reconstruction
from graphgs.synth.course import CourseName
from graphgs.synth.drive import RIGS, plan_drive
from graphgs.synth.layout import build_street
from graphgs.synth.truth import TruthBuilder

GAMMA = 2.2  # a stop of exposure multiplies display values by 2 ** (1 / GAMMA)
EXIF_FOCAL_35MM = 0xA405
EXIF_IFD = 0x8769
FILM_DIAGONAL = 43.27  # [mm] of 36 x 24 mm film


@dataclass(frozen=True)
class StreetConfig:
    """A drive through a street, photographed."""

    frames: int = 36  # places along the drive; 12 are enough for a quick test
    cameras: Literal[1, 3] = 1  # front, or front, left and right as on a mapping vehicle
    width: int = 480  # [px]
    height: int = 270  # [px]
    fov_deg: float = 65.0  # horizontal field of view, about a phone's main camera
    spacing: float = 0.7  # [m] driven between two frames
    course: CourseName = "winding"  # of the road; bend turns by 30 degrees over the drive, corner by 90 in 32 m
    sway: float = 1.0  # how much the vehicle sways, nods and rolls; a car does .1 to .2 of it, 0 is a drive on rails
    exposure_stops: float = 0.0  # each photo is brighter or darker by up to so many stops
    noise: float = 0.0  # [grey levels] standard deviation of the sensor's noise
    samples: int = 3  # rays per pixel and axis where surfaces meet
    texels_per_m: float = 48.0  # texture resolution; a house front 8 m away has about 47 px per metre at 480 px width
    points: int = 6000  # surface points in the true model
    depth: bool = True  # write the depth images
    exif: bool = True  # write the focal length into the photos, as a phone does
    seed: int = 0

    def __post_init__(self):
        for name in ("frames", "width", "height", "spacing", "samples", "texels_per_m", "points"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name}: expected more than 0, got {getattr(self, name)}")
        if not 10.0 <= self.fov_deg <= 140.0:
            raise ValueError(f"fov_deg: expected 10 to 140, got {self.fov_deg}")
        if self.cameras not in RIGS:
            raise ValueError(f"cameras: expected 1 or 3, got {self.cameras}")
        if self.course not in get_args(CourseName):
            raise ValueError(f"course: expected one of {', '.join(get_args(CourseName))}, got {self.course}")
        for name in ("sway", "exposure_stops", "noise"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name}: expected 0 or more, got {getattr(self, name)}")

    @property
    def camera(self) -> Camera:
        """The intrinsics all cameras of the rig share."""
        focal = 0.5 * self.width / np.tan(np.radians(self.fov_deg) / 2)
        return Camera.pinhole(self.width, self.height, focal, focal, self.width / 2, self.height / 2)


@dataclass(frozen=True)
class Street:
    """What was written."""

    images: Path  # folder of the photos: 000001.jpg, or front/000001.jpg with three cameras
    truth: Path  # COLMAP model, depth/NAME.npz, exposures.json
    reconstruction: Reconstruction  # true cameras, poses, and surface points with their tracks; names sorted

    def depth(self, name: str) -> np.ndarray:
        """[H, W] float32 camera z at the pixel centres, metres, 0 = sky. Needs `StreetConfig.depth`."""
        with np.load(self.truth / "depth" / f"{Path(name).with_suffix('')}.npz") as arrays:
            return arrays["depth"]


def write_street(
    config: StreetConfig,
    folder: Path,
    *,
    reporter: Reporter | None = None,
    threads: int = 1,
    device: str = "cpu",
) -> Street:
    """Photograph the street of `config.seed` into folder/images, with folder/truth beside it.

    The same config gives the same bytes, for any number of threads.
    """
    reporter = reporter or Reporter()
    folder = Path(folder)
    street = build_street(
        config.spacing * (config.frames - 1),
        seed=config.seed,
        texels_per_m=config.texels_per_m,
        course=config.course,
    )
    scene = street.build(device=device)
    camera = config.camera
    shots = plan_drive(street.line, config.frames, config.cameras, config.spacing, config.seed, sway=config.sway)
    stops = config.exposure_stops * np.random.default_rng([config.seed, 4]).uniform(-1, 1, len(shots))

    truth = TruthBuilder(camera, points_per_shot=-(-config.points // len(shots)), seed=config.seed)
    try:
        for done, (shot, stop) in enumerate(zip(shots, stops, strict=True)):
            image, depth = raycast(
                scene,
                shot.viewmat,
                camera.K,
                config.width,
                config.height,
                samples=config.samples,
                gain=float(2.0 ** (stop / GAMMA)),
                sky_seed=config.seed,
                threads=threads,
            )
            photo = with_noise(image, config.noise, np.random.default_rng([config.seed, 5, done]))
            write_photo(folder / "images" / f"{shot.name}.jpg", photo, camera if config.exif else None)
            if config.depth:
                target = folder / "truth" / "depth" / f"{shot.name}.npz"
                target.parent.mkdir(parents=True, exist_ok=True)
                np.savez_compressed(target, depth=depth)
            truth.add(shot.viewmat, image, depth)
            reporter.progress(done + 1, len(shots), shot.name)

        names = [f"{shot.name}.jpg" for shot in shots]
        reconstruction = truth.finish(names, [shot.camera for shot in shots])
        write_model(reconstruction, folder / "truth")
        exposures = {name: round(float(stop), 6) for name, stop in zip(names, stops, strict=True)}
        (folder / "truth" / "exposures.json").write_text(json.dumps({"stops": exposures}, indent=1) + "\n")
    except OSError as error:
        raise DiskError(
            f"{folder}: cannot write the street: {error}", hint="Choose a folder you may write to, with room left."
        ) from error
    return Street(folder / "images", folder / "truth", reconstruction)


def with_noise(
    image: np.ndarray,  # [H, W, 3] uint8
    deviation: float,  # [grey levels]
    rng: np.random.Generator,
) -> np.ndarray:
    """[H, W, 3] uint8 with the noise of a sensor, the same in all channels: in grey it is as strong as asked for."""
    if deviation == 0:
        return image
    noise = rng.normal(0.0, deviation, image.shape[:2])[..., None]
    return np.clip(np.round(image + noise), 0, 255).astype(np.uint8)


def write_photo(path: Path, image: np.ndarray, camera: Camera | None) -> None:
    """JPEG without chroma subsampling; with a camera, its focal length goes into the EXIF data as a phone writes it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    exif = Image.Exif()
    if camera is not None:
        # Equal diagonals, as the EXIF standard and COLMAP have it; whole millimetres, so about 2 % uncertain.
        focal = round(camera.focal_and_center[0] * FILM_DIAGONAL / np.hypot(camera.width, camera.height))
        exif.get_ifd(EXIF_IFD)[EXIF_FOCAL_35MM] = focal
    Image.fromarray(image).save(path, quality=95, subsampling=0, exif=exif)
