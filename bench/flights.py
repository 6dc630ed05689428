"""Survey flights over open country with exact truth: photos through a lens that bends, a nearly right focal length.

They live beside the benchmark and not in `graphgs synth`: what they are for, a lens and an EXIF focal length that are
wrong by a known amount, a user has no need of.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bench.lens import Lens, distorted
from bench.terrain import Terrain
from graphgs.kernels.raycast import raycast
from graphgs.scene.camera import Camera
from graphgs.scene.colmap import write_model
from graphgs.scene.reconstruction import Reconstruction
from graphgs.synth.street import FILM_DIAGONAL, with_noise, write_photo

EXIF_FOCAL_MM = 24  # what the photos say, as full-frame millimetres; cameras write whole ones
NOISE = 1.0  # [grey levels]
NADIR = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # camera-from-world, north up in the picture


@dataclass(frozen=True)
class FlightConfig:
    """A grid of photos straight down, flown in strips to and fro."""

    relief: float  # [m] between the lowest and the highest ground
    strips: int = 6
    per_strip: int = 7
    width: int = 640  # [px]
    height: int = 480  # [px]
    altitude: float = 60.0  # [m] above the mean ground
    along: float = 19.0  # [m] between photos of a strip: 70 % of a photo is in the next one
    across: float = 30.0  # [m] between strips: they share 65 %
    tilt_deg: float = 1.5  # standard deviation from the vertical, in each of two directions: no gimbal is perfect
    seed: int = 0

    @property
    def camera(self) -> Camera:
        """The true one: its focal length is 2 to 3 % off what the photos say, its distortion a weak barrel."""
        rng = np.random.default_rng([self.seed, 2])
        off = rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.03)
        focal = self.said.params[0] * (1.0 + off)
        k = rng.uniform(-0.05, -0.02)
        return Camera("SIMPLE_RADIAL", self.width, self.height, (focal, self.width / 2, self.height / 2, k))

    @property
    def said(self) -> Camera:
        """What the photos' EXIF data say of the camera."""
        focal = EXIF_FOCAL_MM / FILM_DIAGONAL * np.hypot(self.width, self.height)
        return Camera.pinhole(self.width, self.height, focal, focal, self.width / 2, self.height / 2)

    @property
    def terrain(self) -> Terrain:
        reach = np.array([self.across * (self.strips - 1), self.along * (self.per_strip - 1)]) / 2
        margin = 0.5 * np.array([self.width, self.height]) / self.camera.params[0] * self.altitude
        return Terrain(tuple(reach + 1.5 * margin + 12.0), relief=self.relief, seed=self.seed)


def write_flight(config: FlightConfig, folder: Path, *, points: int = 4000) -> Reconstruction:
    """Photos into folder/images, the truth as a COLMAP model into folder/truth; the truth is returned as well."""
    lens, scene, truth = Lens(config.camera), config.terrain.build(device="cpu"), true_model(config, points=points)
    for k, (name, viewmat) in enumerate(zip(truth.names, truth.viewmats, strict=True)):
        picture, _ = raycast(scene, viewmat, lens.pinhole.K, lens.pinhole.width, lens.pinhole.height, samples=1)
        noisy = with_noise(lens.photograph(picture), NOISE, np.random.default_rng([config.seed, 4, k]))
        write_photo(folder / "images" / name, noisy, config.said)
    write_model(truth, folder / "truth")
    return truth


def true_model(config: FlightConfig, *, points: int = 4000) -> Reconstruction:
    """Poses, lens, and points on the ground with the photos that see them; from straight above, nothing hides them."""
    camera, terrain = config.camera, config.terrain
    rotations, centers = fly(config)
    translations = -np.einsum("nij,nj->ni", rotations, centers)
    rng = np.random.default_rng([config.seed, 5])
    x, z = rng.uniform(-1, 1, (2, points)) * np.array(terrain.reach)[:, None]
    ground = np.stack([x, -terrain.height(x, z), z], axis=1)
    fx, fy, cx, cy = camera.focal_and_center
    local = np.einsum("nij,pj->pni", rotations, ground) + translations
    xy = distorted(local[..., :2] / local[..., 2:], camera) * [fx, fy] + [cx, cy]  # [P, N, 2]
    seen = ((xy > 0) & (xy < [camera.width, camera.height])).all(-1)
    kept = seen.sum(1) >= 2
    ground, seen, xy = ground[kept], seen[kept], xy[kept]
    return Reconstruction(
        cameras=(camera,),
        names=tuple(f"{k:03d}.jpg" for k in range(len(centers))),
        camera_ids=np.zeros(len(centers), np.int64),
        rotations=rotations,
        translations=translations,
        points=ground,
        colors=np.full((len(ground), 3), 128, np.uint8),
        errors=np.zeros(len(ground)),
        track_offsets=np.concatenate([[0], np.cumsum(seen.sum(1))]).astype(np.int64),
        track_images=np.nonzero(seen)[1].astype(np.int32),
        track_xy=xy[seen],
    )


def fly(config: FlightConfig) -> tuple[np.ndarray, np.ndarray]:
    """(rotations [N, 3, 3] camera-from-world, centres [N, 3]) in the order the photos are taken."""
    rng = np.random.default_rng([config.seed, 3])
    rotations, centers = [], []
    for strip in range(config.strips):
        east = config.across * (strip - (config.strips - 1) / 2)
        back = strip % 2 == 1
        for place in range(config.per_strip):
            north = config.along * (place - (config.per_strip - 1) / 2) * (-1.0 if back else 1.0)
            centers.append([east, -config.altitude, north] + rng.normal(0, [1.0, 0.5, 1.0]))
            tilts = rng.normal(0, config.tilt_deg, 2)
            body = Rotation.from_euler("zxy", [rng.normal(180.0 if back else 0.0, 3.0), *tilts], degrees=True)
            rotations.append(body.as_matrix().T @ NADIR)
    return np.array(rotations), np.array(centers)
