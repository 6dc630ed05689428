"""From relative poses of pairs to global ones, and what is refused."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graphgs.errors import DataError, UsageError
from graphgs.scene.similarity import align, diameter
from graphgs.structure.relative_poses import RelativePoses, global_poses, load_estimate


def scene(n: int = 14, seed: int = 0):
    """(rotations, centers) of cameras on a bent path."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 2, n)
    centers = np.stack([3 * np.sin(t), 0.2 * rng.normal(size=n), 3 * t], axis=1)
    return Rotation.from_rotvec(np.stack([0 * t, 0.8 * t, 0.1 * np.sin(3 * t)], axis=1)).as_matrix(), centers


def relative_of(rotations, centers, pairs) -> RelativePoses:
    i, j = np.array(pairs).T
    turn = rotations[j] @ rotations[i].transpose(0, 2, 1)
    shift = np.einsum("pij,pj->pi", rotations[j], centers[i] - centers[j])
    return RelativePoses(np.array(pairs), turn, shift * np.linspace(0.1, 9, len(i))[:, None], np.ones(len(i)))


def window(n: int, width: int) -> list[tuple[int, int]]:
    return [(a, b) if (a + b) % 3 else (b, a) for a in range(n) for b in range(a + 1, min(n, a + width + 1))]


def errors(found, truth):
    """(position errors in % of the scene, angles in degrees after the best turn)."""
    (placed, rotations, centers), (true_rotations, true_centers) = found, truth
    fit = align(centers[placed], true_centers[placed])
    moved = 100 * np.linalg.norm(fit.apply(centers[placed]) - true_centers[placed], axis=1) / diameter(true_centers)
    turned = rotations[placed] @ fit.rotation.T @ true_rotations[placed].transpose(0, 2, 1)
    return moved, np.degrees(Rotation.from_matrix(turned).magnitude())


def test_exact_relative_poses_give_exact_global_ones():
    truth = scene()
    found = global_poses(relative_of(*truth, window(14, 3)), 14)
    assert found[0].all()
    moved, turned = errors(found, truth)
    # Newton's equations are kept solvable by a millionth; the turn is that of aligning the positions.
    assert moved.max() < 0.1
    assert turned.max() < 0.1


def test_a_sixth_of_wrong_pairs_does_little_harm():
    truth = scene()
    relative = relative_of(*truth, window(14, 5))
    rng = np.random.default_rng(3)
    count = len(relative.pairs)
    noise = Rotation.from_rotvec(rng.normal(0, 0.01, (count, 3))).as_matrix()
    rotations, translations = noise @ relative.rotations, relative.translations.copy()
    wrong = rng.choice(count, count // 6, replace=False)
    rotations[wrong] = Rotation.random(len(wrong), random_state=4).as_matrix()
    translations[wrong] = rng.normal(size=(len(wrong), 3))
    moved, turned = errors(
        global_poses(RelativePoses(relative.pairs, rotations, translations, np.ones(count)), 14), truth
    )
    # 0.01 rad of noise per pair is 0.6 degrees; the tree alone would add some of it up over ten cameras
    assert np.median(turned) < 1.5
    assert np.median(moved) < 5


def test_only_the_largest_group_is_placed():
    truth = scene()
    pairs = [*window(8, 2), (9, 10), (11, 12)]
    relative = relative_of(*truth, pairs)
    confidence = relative.confidence.copy()
    confidence[np.flatnonzero((np.array(pairs) == 7).any(1))] = 0.0  # the model says nothing about 7
    placed, _, centers = global_poses(dataclasses.replace(relative, confidence=confidence), 14)
    assert np.flatnonzero(placed).tolist() == list(range(7))
    assert np.isnan(centers[7:]).all()
    with pytest.raises(DataError, match="no three photos"):
        global_poses(relative_of(*truth, [(0, 1), (2, 3)]), 14)


@pytest.mark.parametrize(
    "change",
    [
        {"rotations": np.zeros((2, 3))},
        {"confidence": np.ones(3)},
        {"pairs": np.array([[0, 1], [2, 2]])},
        {"pairs": np.array([[0, 1], [2, 99]])},
    ],
)
def test_answers_that_do_not_fit_are_refused(change):
    relative = relative_of(*scene(), [(0, 1), (1, 2)])
    with pytest.raises(ValueError, match="expected"):
        global_poses(dataclasses.replace(relative, **change), 14)


def test_the_function_comes_from_a_file(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("def estimate(paths, pairs):\n    return len(paths)\nnumber = 3\n")
    assert load_estimate(f"{file}:estimate")([1, 2], None) == 2
    for wanted in (f"{file}:number", f"{file}:nothing", f"{tmp_path / 'none.py'}:estimate", str(file), "estimate"):
        with pytest.raises(UsageError):
            load_estimate(wanted)
