"""The synthetic street as cameras see it, without photos: true poses, true overlap, and the coarse points of a prior.

Geometry only: depth images from the ray caster stand for the surface. Lengths in metres.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np

from graphgs.kernels.raycast import raycast
from graphgs.synth.drive import plan_drive
from graphgs.synth.layout import build_street
from graphgs.synth.street import StreetConfig
from tests.support.camera_tracks import noisy

TOLERANCE = 0.02  # relative; a point counts as seen where the depth image, interpolated, agrees
SCALE_CHANGE = 2.5  # a feature is recognised while it appears at most so much larger or smaller
FOUND_AGAIN = 0.6  # share of the cameras in sight of a feature that really have it in their track
OUTLIERS = 0.02  # share of the coarse points whose depth is wrong by up to a factor of two


@dataclass(frozen=True)
class CoarsePoints:
    """What a coarse reconstruction knows of the scene."""

    points: np.ndarray  # [K, 3] world
    visible: np.ndarray  # [V, 2] int: camera, point


@dataclass(frozen=True)
class StreetViews:
    """Cameras of a drive, sorted by photo name, and what they see."""

    rotations: np.ndarray  # [N, 3, 3] camera-from-world
    centers: np.ndarray  # [N, 3]
    fov_deg: tuple[float, float]
    samples: np.ndarray  # [N, S, 3] world: surface points at random pixels; NaN = sky
    inverse_depths: np.ndarray  # [N, H, W] 1/m at the pixel centres, 0 = sky
    seed: int

    def sees(self, camera: int, world: np.ndarray) -> np.ndarray:
        """[n] bool: which surface points [n, 3] a camera sees. 1 / depth is linear over a plane's image."""
        height, width = self.inverse_depths.shape[1:]
        x, y, z = ((world - self.centers[camera]) @ self.rotations[camera].T).T
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = (np.stack([x, y]) / z) / np.tan(np.radians(self.fov_deg) / 2)[:, None]
            inside = (z > 0.05) & (np.abs(u) < 1) & (np.abs(v) < 1)
        seen = np.zeros(len(world), bool)
        z = z[inside]
        col = np.clip((u[inside] + 1) / 2 * width - 0.5, 0, width - 1.001)
        row = np.clip((v[inside] + 1) / 2 * height - 0.5, 0, height - 1.001)
        c, r = col.astype(int), row.astype(int)
        a, b = col - c, row - r
        image = self.inverse_depths[camera]
        top = (1 - a) * image[r, c] + a * image[r, c + 1]
        bottom = (1 - a) * image[r + 1, c] + a * image[r + 1, c + 1]
        seen[inside] = np.abs(((1 - b) * top + b * bottom) * z - 1.0) < TOLERANCE
        return seen

    def shared(self, pairs: np.ndarray) -> np.ndarray:
        """[P, 2] share of what each camera of a pair sees that the other one sees too."""
        share = np.zeros(pairs.shape)
        for way, (i, j) in enumerate((pairs.T, pairs[:, ::-1].T)):
            order = np.argsort(j, kind="stable")
            cameras, start = np.unique(j[order], return_index=True)
            for camera, rows in zip(cameras, np.split(order, start[1:]), strict=True):
                samples = self.samples[i[rows]]
                surface = np.isfinite(samples[..., 0])
                seen = np.zeros(surface.shape, bool)
                seen[surface] = self.sees(camera, samples[surface])
                share[rows, way] = seen.sum(1) / np.maximum(surface.sum(1), 1)
        return share

    def coarse_points(self, *, per_camera: int = 24, depth_noise: float = 0.01) -> CoarsePoints:
        """Surface points that at least two cameras have a feature at. `per_camera` start from each camera; a camera
        ends up with several times as many. Depths as seen from there are off by `depth_noise` (relative, sigma)."""
        rng = np.random.default_rng([self.seed, 11])
        n = len(self.centers)
        start = np.repeat(np.arange(n), per_camera)
        true = self.samples[:, :per_camera].reshape(-1, 3)
        start, true = start[np.isfinite(true[:, 0])], true[np.isfinite(true[:, 0])]
        reach = np.linalg.norm(true - self.centers[start], axis=1)
        tracks = []
        for camera in range(n):
            distance = np.linalg.norm(true - self.centers[camera], axis=1)
            alike = (distance < SCALE_CHANGE * reach) & (reach < SCALE_CHANGE * distance)
            near = np.flatnonzero(alike)
            seen = near[self.sees(camera, true[near])]
            found = seen[(rng.random(len(seen)) < FOUND_AGAIN) | (start[seen] == camera)]
            tracks.append(np.stack([np.full(len(found), camera), found], axis=1))
        visible = np.concatenate(tracks)
        used = np.bincount(visible[:, 1], minlength=len(true)) >= 2
        visible = visible[used[visible[:, 1]]]
        factor = 1.0 + depth_noise * rng.normal(size=len(true))
        wrong = rng.random(len(true)) < OUTLIERS
        factor[wrong] = 2.0 ** rng.uniform(-1, 1, wrong.sum())
        moved = self.centers[start] + factor[:, None] * (true - self.centers[start])
        return CoarsePoints(moved[used], np.stack([visible[:, 0], (np.cumsum(used) - 1)[visible[:, 1]]], axis=1))

    def with_noise(
        self, coarse: CoarsePoints, *, angle: float, offset: float, seed: int
    ) -> tuple[np.ndarray, np.ndarray, CoarsePoints]:
        """(rotations, centers, points) of a prior whose cameras are turned by up to `angle` rad and shifted by up to
        `offset` along each axis. A point goes where its cameras, each turned and shifted, put it on average."""
        rotations, centers = noisy(self.rotations, self.centers, angle=angle, offset=offset, seed=seed)
        camera, point = coarse.visible.T
        local = np.einsum("vab,vb->va", self.rotations[camera], coarse.points[point] - self.centers[camera])
        put = np.einsum("vba,vb->va", rotations[camera], local) + centers[camera]
        count = np.bincount(point, minlength=len(coarse.points))
        mean = np.stack([np.bincount(point, put[:, k], len(coarse.points)) for k in range(3)], 1) / count[:, None]
        return rotations, centers, dataclasses.replace(coarse, points=mean)


def street_views(
    frames: int,
    *,
    cameras: int = 3,
    seed: int = 0,
    width: int = 240,  # [px] of the depth images
    samples: int = 500,  # surface points per camera that overlap is judged by
    threads: int = 1,
) -> StreetViews:
    """The street of `graphgs synth street` with that many frames."""
    config = StreetConfig(frames=frames, cameras=cameras, width=width, height=round(width * 9 / 16), seed=seed)
    # The texture's resolution changes no surface; below 12 the smallest ones would vanish.
    street = build_street(config.spacing * (frames - 1), seed=seed, texels_per_m=12.0)
    scene = street.build(device="cpu")
    shots = sorted(plan_drive(street.line, frames, cameras, config.spacing, seed), key=lambda shot: shot.name)
    K = config.camera.K
    fx, fy, cx, cy = config.camera.focal_and_center
    rng = np.random.default_rng([seed, 10])
    inverse_depths, surface = [], []
    for shot in shots:
        depth = raycast(scene, shot.viewmat, K, config.width, config.height, samples=1, threads=threads)[1]
        inverse_depths.append(np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0))
        pixel = rng.choice(depth.size, samples, replace=False)
        row, col = np.divmod(pixel, config.width)
        z = np.where(depth > 0, depth, np.nan).ravel()[pixel].astype(float)
        local = np.column_stack([(col + 0.5 - cx) / fx * z, (row + 0.5 - cy) / fy * z, z])
        surface.append((local - shot.viewmat[:3, 3]) @ shot.viewmat[:3, :3])
    viewmats = np.stack([shot.viewmat for shot in shots])
    rotations = viewmats[:, :3, :3]
    vertical = 2 * np.degrees(np.arctan(config.height / (2 * fy)))
    return StreetViews(
        rotations=rotations,
        centers=-np.einsum("nji,nj->ni", rotations, viewmats[:, :3, 3]),
        fov_deg=(config.fov_deg, float(vertical)),
        samples=np.stack(surface),
        inverse_depths=np.stack(inverse_depths),
        seed=seed,
    )
