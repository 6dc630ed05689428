"""Depths by plane sweep: the likeness of patches against a slow twin, and known surfaces found."""

import cv2
import numpy as np
import pytest

from graphgs.points.plane_sweep import WINDOW, PosedImage, likenesses, sweep
from tests.support.reference.plane_sweep import likeness
from tests.support.textured_walls import HEIGHT, WIDTH, textured_walls

RANGE = (2.0, 12.0)


def _posed(walls, k: int) -> PosedImage:
    gray = cv2.cvtColor(walls.views.read(k)[0], cv2.COLOR_RGB2GRAY).astype(np.float32)
    return PosedImage(gray, walls.views.Ks[k], walls.views.viewmats[k])


@pytest.mark.parametrize("partners", [[2], [2, 4], [1, 2, 4, 5]])
def test_likeness_is_the_twins(tmp_path, partners):
    walls = textured_walls(tmp_path)
    image, others = _posed(walls, 3), [_posed(walls, j) for j in partners]
    planes = np.array([0.1, 0.18, 0.2, 0.24, 0.4])
    found = likenesses(image, others, planes)
    assert found.shape == (5, HEIGHT, WIDTH)
    rng = np.random.default_rng(1)
    half = WINDOW // 2
    for _ in range(40):
        row, column = rng.integers(half, HEIGHT - half), rng.integers(half, WIDTH - half)
        for k, plane in enumerate(planes):
            # OpenCV warps to 1/32 px, which moves these steep grey values by a few levels.
            assert found[k, row, column] == pytest.approx(likeness(image, others, plane, row, column), abs=0.03)


def test_surfaces_are_found(tmp_path):
    walls = textured_walls(tmp_path)
    inverse = sweep(_posed(walls, 3), [_posed(walls, j) for j in (1, 2, 4, 5)], RANGE)
    known = inverse > 0
    assert known.mean() > 0.8
    error = np.abs(inverse[known] * walls.depths[3][known] - 1)
    assert np.median(error) < 0.005
    assert (error < 0.02).mean() > 0.95


def test_exposure_does_not_matter(tmp_path):
    walls = textured_walls(tmp_path, gains=(1, 1, 0.5, 0.9, 0.6, 1, 1))
    inverse = sweep(_posed(walls, 3), [_posed(walls, 2), _posed(walls, 4)], RANGE)
    known = inverse > 0
    assert known.mean() > 0.7
    assert np.median(np.abs(inverse[known] * walls.depths[3][known] - 1)) < 0.01


def test_nothing_is_found_where_nothing_is_seen(tmp_path):
    walls = textured_walls(tmp_path)
    image, other = _posed(walls, 3), _posed(walls, 2)
    blank = PosedImage(np.full_like(image.gray, 90.0), image.K, image.viewmat)
    assert not sweep(blank, [other], RANGE).any()
    behind = other.viewmat.copy()
    behind[:3] = np.diag([-1.0, 1.0, -1.0]) @ behind[:3]  # looks the other way
    assert not sweep(image, [PosedImage(other.gray, other.K, behind)], RANGE).any()


def test_planes_that_miss_the_surface_find_little(tmp_path):
    walls = textured_walls(tmp_path)
    inverse = sweep(_posed(walls, 3), [_posed(walls, j) for j in (1, 2, 4, 5)], (20.0, 60.0))
    assert (inverse > 0).mean() < 0.2
