"""Small models with a known lens: a drive straight ahead, one through a bend, flights over flat and over hilly ground.

`write_model` saves one as COLMAP's worker does, in a process of its own, as all that loads pycolmap.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.calibration.projection import distort

KINDS = ("straight", "bend", "flat", "hilly")
ZOOM = 1.4
LENS = Camera("RADIAL", 800, 600, (600.0, 412.0, 294.0, -0.04, 0.01))


def lens_scene(
    kind: str, *, noise_px: float = 0.3, seed: int = 0, lens: Camera = LENS, zoomed: tuple[int, ...] = ()
) -> Reconstruction:
    """True poses and points; observations through `lens`, with noise. `zoomed` photos were taken with a lens of
    ZOOM times the focal length, which the one camera does not say."""
    rng = np.random.default_rng(seed)
    rotations, centers = _drive(kind) if kind in ("straight", "bend") else _flight(tilted=kind == "hilly")
    if kind in ("straight", "bend"):
        count = 1500
        along = rng.integers(0, len(centers), count)
        points = centers[along] + np.einsum("nji,nj->ni", rotations[along], _street(rng, count))
    else:
        count = 1200
        points = np.column_stack([rng.uniform(-14, 14, (count, 2)), np.zeros(count)])
        if kind == "hilly":
            points[:, 2] = 1.5 * np.sin(points[:, 0] / 3.0) + 1.5 * np.cos(points[:, 1] / 4.0)
    local = np.einsum("nij,pnj->pni", rotations, points[:, None] - centers)
    ahead = local[..., 2] > 1.0
    rays = local[..., :2] / np.where(ahead, local[..., 2], 1.0)[..., None]
    fx, fy, cx, cy = lens.focal_and_center
    zoom = np.where(np.isin(np.arange(len(centers)), zoomed), ZOOM, 1.0)[:, None]
    seen = zoom * distort(lens, rays.reshape(-1, 2)).reshape(rays.shape) * [fx, fy] + [cx, cy]
    inside = ahead & (seen >= 0).all(-1) & (seen < [lens.width, lens.height]).all(-1) & (local[..., 2] < 30.0)
    inside &= np.linalg.norm(rays, axis=-1) < 1.2
    kept = inside.sum(1) >= 3
    points, inside, seen = points[kept], inside[kept], seen[kept]
    track, image = np.nonzero(inside)
    n = len(centers)
    return Reconstruction(
        cameras=(lens,),
        names=tuple(f"{k:03d}.png" for k in range(n)),
        camera_ids=np.zeros(n, np.int64),
        rotations=rotations,
        translations=-np.einsum("nij,nj->ni", rotations, centers),
        points=points,
        colors=np.zeros((len(points), 3), np.uint8),
        errors=np.full(len(points), noise_px),
        track_offsets=np.concatenate([[0], np.cumsum(inside.sum(1))]).astype(np.int64),
        track_images=image.astype(np.int32),
        track_xy=seen[track, image] + rng.normal(0, noise_px, (len(track), 2)),
    )


def _street(rng, count: int) -> np.ndarray:
    """[count, 3] points beside, above and ahead of a car, in its camera's frame."""
    return np.column_stack([rng.uniform(-8, 8, count), rng.uniform(-4, 1.5, count), rng.uniform(5, 25, count)])


def _drive(kind: str) -> tuple[np.ndarray, np.ndarray]:
    steps, heading = 30, 0.0
    rotations, centers, place = [], [], np.zeros(3)
    for k in range(steps):
        if kind == "bend":
            heading = 1.4 * (k / steps) ** 2
        c, s = np.cos(heading), np.sin(heading)
        rotations.append(np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]))
        centers.append(place.copy())
        place += np.array([s, 0.0, c])
    return np.array(rotations), np.array(centers)


def _flight(*, tilted: bool) -> tuple[np.ndarray, np.ndarray]:
    """Looking straight down; cameras that all look alike leave the focal length open over any ground, so over hills the
    aircraft rolls and nods by some degrees."""
    x, y = np.meshgrid(np.linspace(-9, 9, 6), np.linspace(-9, 9, 6))
    centers = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 12.0)])
    tilt = np.random.default_rng(1).normal(0.0, 0.1 if tilted else 0.0, (x.size, 3))
    return Rotation.from_rotvec(tilt).as_matrix() @ np.diag([1.0, -1.0, -1.0]), centers


def write_model(kind: str, folder: Path, *, zoomed: tuple[int, ...] = ()) -> Path:
    """The scene as a model that bundle adjustment can go on from."""
    photos = [str(k) for k in zoomed]
    subprocess.run([sys.executable, "-m", "tests.support.lens_scenes", kind, str(folder), *photos], check=True)
    return folder


def _save(kind: str, folder: str, *zoomed: str) -> None:
    import zlib  # noqa: F401

    import pycolmap

    from graphgs.structure.colmap_jobs.convert import save

    scene, model = lens_scene(kind, zoomed=tuple(map(int, zoomed))), pycolmap.Reconstruction()
    camera = scene.cameras[0]
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(camera_id=1, model=camera.model, width=camera.width, height=camera.height, params=camera.params)
    )
    number = np.zeros(len(scene.track_images), np.int64)
    for k, name in enumerate(scene.names):
        rows = np.flatnonzero(scene.track_images == k)
        number[rows] = np.arange(len(rows))
        image = pycolmap.Image(name=name, keypoints=scene.track_xy[rows], camera_id=1, image_id=k + 1)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(scene.rotations[k]), scene.translations[k])
        model.add_image_with_trivial_frame(image, pose)
    for p, point in enumerate(scene.points):
        track = pycolmap.Track()
        for row in range(scene.track_offsets[p], scene.track_offsets[p + 1]):
            track.add_element(int(scene.track_images[row]) + 1, int(number[row]))
        model.add_point3D(point, track)
    save(model, folder)


if __name__ == "__main__":
    _save(*sys.argv[1:])
