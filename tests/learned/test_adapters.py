"""Adapters for pairwise models, on stand-ins with the interfaces of DUSt3R / MASt3R and VGGT that know the truth."""

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from graphgs.learned import pointmaps, vggt

FOCAL, WIDTH, HEIGHT = 400.0, 512, 384
ROTATIONS = Rotation.from_rotvec([[0, 0, 0], [0.05, 0.3, 0.0], [0, -0.2, 0.1]]).as_matrix()  # camera-from-world
CENTERS = np.array([[0, 0, 0], [0.8, 0.1, 0.2], [-0.6, 0, 0.1]])
PAIRS = np.array([[0, 1], [2, 1], [0, 2]])


@pytest.fixture
def photos(tmp_path):
    """Pictures whose colour tells which camera took them."""
    paths = []
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((HEIGHT, WIDTH, 3), 40 + 60 * k, np.uint8))
        paths.append(tmp_path / f"{k}.png")
    return paths


def truth(i, j):
    turn = ROTATIONS[j] @ ROTATIONS[i].T
    return turn, ROTATIONS[j] @ (CENTERS[i] - CENTERS[j])


def camera_of(grey: float) -> int:
    return round((grey - 40) / 60)


class PointmapModel:
    """Answers as DUSt3R does, from a wavy surface some 4 m away; confidence is low where the answer is wrong."""

    def __call__(self, first, second):
        i, j = (camera_of(float((view["img"].mean() + 1) * 127.5)) for view in (first, second))
        own, other = self.points(i), self.points(j)
        turn, shift = truth(j, i)
        moved = other @ turn.T + shift
        conf = np.full((HEIGHT, WIDTH), 5.0)
        conf[:100], moved[:100] = 1.0, 9.0
        scale = 0.3  # models have a scale of their own
        assert first["img"].shape == (1, 3, HEIGHT, WIDTH)
        return (
            {"pts3d": self.tensor(scale * own), "conf": self.tensor(conf)},
            {"pts3d_in_other_view": self.tensor(scale * moved), "conf": self.tensor(conf)},
        )

    @staticmethod
    def points(k):
        """[H, W, 3] in camera k."""
        y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
        depth = 4 + np.sin(0.02 * x + k) + 0.5 * np.cos(0.03 * y)
        return np.stack([(x - WIDTH / 2) / FOCAL, (y - HEIGHT / 2) / FOCAL, np.ones_like(x)], -1) * depth[..., None]

    @staticmethod
    def tensor(array):
        return torch.from_numpy(array)[None].float()


def test_pointmaps_give_relative_poses(photos):
    found = pointmaps.relative_poses(PointmapModel(), photos, PAIRS)
    for p, (i, j) in enumerate(PAIRS):
        turn, shift = truth(i, j)
        assert np.degrees(Rotation.from_matrix(found.rotations[p] @ turn.T).magnitude()) < 0.05
        np.testing.assert_allclose(found.translations[p], 0.3 * shift, atol=2e-3)
    assert (found.confidence > 2).all()


def test_a_pair_without_a_pose_has_no_confidence(photos):
    class Confused(PointmapModel):
        def __call__(self, first, second):
            own, other = super().__call__(first, second)
            noise = torch.rand(other["pts3d_in_other_view"].shape, generator=torch.Generator().manual_seed(0))
            return own, other | {"pts3d_in_other_view": noise}

    clear = pointmaps.relative_poses(PointmapModel(), photos, PAIRS)
    confused = pointmaps.relative_poses(Confused(), photos, PAIRS)
    assert (confused.confidence < 0.1 * clear.confidence).all()


def test_vggt_gives_relative_poses(photos):
    def model(images):
        assert images.shape[:3] == (1, 2, 3)
        assert images.shape[3] % 14 == images.shape[4] % 14 == 0
        cameras = [camera_of(255 * float(image.mean())) for image in images[0]]
        encoded = np.zeros((1, 2, 9))
        for s, k in enumerate(cameras):
            encoded[0, s, :3] = -ROTATIONS[k] @ CENTERS[k]
            encoded[0, s, 3:7] = Rotation.from_matrix(ROTATIONS[k]).as_quat()
        return {"pose_enc": torch.from_numpy(encoded), "depth_conf": torch.full((1, 2, 8, 8), 3.0)}

    found = vggt.relative_poses(model, photos, PAIRS)
    for p, (i, j) in enumerate(PAIRS):
        turn, shift = truth(i, j)
        np.testing.assert_allclose(found.rotations[p], turn, atol=1e-6)
        np.testing.assert_allclose(found.translations[p], shift, atol=1e-6)
    assert found.confidence.tolist() == [3.0] * 3
