"""What a set's photos can tell about their lens at best: geometry alone, no reconstruction looked at.

The Cramer-Rao bound: true poses and points give the normal equations of a bundle adjustment in which everything is
free, one focal length and one distortion term for all photos; with points and poses eliminated, what is left is the
information about the lens.
"""

import numpy as np

from graphgs.scene.reconstruction import Reconstruction

NOISE_PX = 0.5  # of a feature's position
PER_PHOTO = 800  # observations
LONGEST = 8  # photos that see a feature one after the other; features do not live as long as points do
POINTS = 3000
FLATTEST = 1e12  # condition of a point's own equations beyond which it is not known
LOST = 1e-9  # share of a parameter's information that has to survive the elimination; below it is rounding


def focal_deviation(truth: Reconstruction, *, seed: int = 0) -> float:
    """[%] standard deviation of the focal length; infinite where the photos do not tell it."""
    camera = truth.cameras[0]
    rng = np.random.default_rng(seed)
    size = 6 * len(truth.names) + 2
    normal, observations = np.zeros((size, size)), 0
    for point in rng.permutation(len(truth.points))[:POINTS]:
        seen_by = np.sort(truth.track_images[truth.track_offsets[point] : truth.track_offsets[point + 1]])
        start = rng.integers(max(1, len(seen_by) - LONGEST + 1))
        images = seen_by[start : start + LONGEST]
        columns = np.concatenate([(6 * images[:, None] + np.arange(6)).ravel(), [size - 2, size - 1]])
        by_camera, by_point = _derivatives(truth, camera, images, truth.points[point])
        own = by_point.T @ by_point
        if np.linalg.cond(own) < FLATTEST:
            coupling = by_camera.T @ by_point
            eliminated = coupling @ np.linalg.solve(own, coupling.T)
            normal[np.ix_(columns, columns)] += by_camera.T @ by_camera - eliminated
            observations += len(images)
    lens, poses = np.arange(size - 2, size), _without_the_world(truth)
    left = normal[np.ix_(lens, lens)] - normal[np.ix_(lens, poses)] @ np.linalg.solve(
        normal[np.ix_(poses, poses)], normal[np.ix_(poses, lens)]
    )
    focal = left[0, 0] - left[0, 1] ** 2 / left[1, 1]  # the distortion is as unknown as the focal length
    if focal < LOST * normal[size - 2, size - 2]:
        return float("inf")
    return 100 * float(np.sqrt(observations / (PER_PHOTO * len(truth.names)) / focal))


def _without_the_world(truth: Reconstruction) -> np.ndarray:
    """The unknowns of the poses less seven that the world's place, turn and scale take up: those of the first photo,
    and one coordinate of the photo furthest from it. What is told about the lens does not depend on which."""
    baselines = truth.centers - truth.centers[0]
    furthest = int(np.linalg.norm(baselines, axis=1).argmax())
    along = int(np.abs(truth.rotations[furthest] @ baselines[furthest]).argmax())
    return np.setdiff1d(np.arange(6 * len(truth.names)), [*range(6), 6 * furthest + 3 + along])


def _derivatives(truth: Reconstruction, camera, images: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """([2n, 6n + 2] by poses (turn, shift) and lens (relative focal length, distortion), [2n, 3] by the point) of the
    observations of one point, in standard deviations."""
    n = len(images)
    focal = camera.focal_and_center[0] / NOISE_PX
    k = camera.distortion[0] if len(camera.distortion) else 0.0
    rotations = truth.rotations[images]
    x, y, z = local = (rotations @ point + truth.translations[images]).T
    u, v = x / z, y / z
    r2 = u**2 + v**2
    zero, lens = np.zeros(n), 1.0 + k * r2
    flat = np.stack([np.stack([1 / z, zero, -u / z], -1), np.stack([zero, 1 / z, -v / z], -1)], axis=1)
    bent = np.stack(
        [np.stack([lens + 2 * k * u * u, 2 * k * u * v], -1), np.stack([2 * k * u * v, lens + 2 * k * v * v], -1)],
        axis=1,
    )
    by_local = focal * bent @ flat  # [n, 2, 3]
    by_turn = np.cross(local.T[:, None], by_local)  # the local point turns about the camera: a . (w x p) = w . (p x a)
    by_camera = np.zeros((n, 2, 6 * n + 2))
    for i in range(n):
        by_camera[i, :, 6 * i : 6 * i + 3], by_camera[i, :, 6 * i + 3 : 6 * i + 6] = by_turn[i], by_local[i]
    by_camera[:, :, -2] = focal * (lens * np.stack([u, v])).T
    by_camera[:, :, -1] = focal * (r2 * np.stack([u, v])).T
    return by_camera.reshape(2 * n, -1), (by_local @ rotations).reshape(2 * n, 3)
