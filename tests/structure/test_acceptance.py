"""When two reconstructions agree, and what hangs together."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import Similarity
from graphgs.structure.acceptance import Agreement, agreement
from graphgs.structure.components import components, describe
from graphgs.structure.config import StructureConfig
from graphgs.structure.given import covisible_pairs
from graphgs.structure.gps import nearest_by_gps
from graphgs.structure.matching import _in_turn, bridge_candidates, witness_pairs

CONFIG = StructureConfig()


def ring(n=24):
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    rotations = Rotation.from_rotvec(np.stack([0 * angle, angle, 0 * angle], 1)).as_matrix()
    centers = np.stack([np.sin(angle), 0.1 * np.cos(3 * angle), np.cos(angle)], 1)
    return Reconstruction(
        cameras=(Camera.pinhole(10, 10, 8, 8, 5, 5),),
        names=tuple(f"{k:03d}" for k in range(n)),
        camera_ids=np.zeros(n, np.int64),
        rotations=rotations,
        translations=-np.einsum("nij,nj->ni", rotations, centers),
    )


def with_pose(reconstruction, k, rotation, center):
    rotations, translations = reconstruction.rotations.copy(), reconstruction.translations.copy()
    rotations[k], translations[k] = rotation, -rotation @ center
    return dataclasses.replace(reconstruction, rotations=rotations, translations=translations)


def test_a_similarity_changes_nothing():
    first = ring()
    turn = Rotation.from_rotvec([0.3, -1.0, 0.2]).as_matrix()
    found = agreement(first, first.transformed(Similarity(7.0, turn, np.array([1.0, 2, 3]))))
    assert found.common == 24
    assert found.rotation_p99_deg < 1e-4
    assert found.largest_shift < 1e-9
    assert found.within(CONFIG)


def test_one_camera_that_moved_is_enough_to_refuse():
    first = ring()
    moved = with_pose(first, 5, first.rotations[5], first.centers[5] + [0.0, 0.12, 0.0])
    found = agreement(first, moved)
    assert found.largest_shift == pytest.approx(0.06, abs=0.005)  # of a diameter of 2
    assert not found.within(CONFIG)
    assert found.rotation_median_deg < 1e-4


def test_cameras_that_turned_are_refused():
    first = ring()
    second = first
    for k in range(3):
        turned = Rotation.from_rotvec([0, 0, np.radians(20)]).as_matrix() @ first.rotations[k]
        second = with_pose(second, k, turned, first.centers[k])
    found = agreement(first, second)
    assert found.rotation_p99_deg == pytest.approx(20, abs=0.1)
    assert found.rotation_median_deg < 1e-4
    assert not found.within(CONFIG)


def test_a_fine_model_far_from_the_coarse_one_is_no_agreement():
    """Figures of a straight drive whose coarse model had bent; the fine one had half straightened, and was wrong."""
    assert not Agreement(51, 1.72, 8.80, 0.0398).within(CONFIG)
    assert Agreement(30, 0.51, 1.03, 0.0109).within(CONFIG)  # of sound models, the pair furthest apart


def test_pairwise_rotation_change_equals_the_definition():
    rng = np.random.default_rng(0)
    first, second = ring(6), ring(6)
    for k in range(6):
        turned = Rotation.from_rotvec(rng.normal(0, 0.2, 3)).as_matrix() @ second.rotations[k]
        second = with_pose(second, k, turned, second.centers[k])
    changes = []
    for i in range(6):
        for j in range(i + 1, 6):
            a = first.rotations[j] @ first.rotations[i].T
            b = second.rotations[j] @ second.rotations[i].T
            changes.append(np.degrees(Rotation.from_matrix(a @ b.T).magnitude()))
    assert agreement(first, second).rotation_median_deg == pytest.approx(np.median(changes), abs=1e-6)


def test_too_few_common_photos_cannot_agree():
    first = ring()
    renamed = dataclasses.replace(first, names=("000", "001", *(f"x{k}" for k in range(22))))
    assert not agreement(first, renamed).within(CONFIG)


def test_components_are_sorted_and_described():
    edges = np.array([[0, 1], [1, 2], [4, 5], [7, 8], [8, 9], [7, 9]])
    groups = components(10, edges)
    assert [g.tolist() for g in groups] == [[0, 1, 2], [7, 8, 9], [4, 5], [3], [6]]
    assert describe("abcdefghij", groups, shown=2) == (
        "3 photos (a, b, ...); 3 photos (h, i, ...); 2 photos (e, f); 1 photo (d); 1 photo (g)"
    )


def test_bridges_lead_from_small_groups_to_their_look_alikes():
    edges = np.array([[0, 1], [1, 2], [3, 4]])
    similar = np.array([[1, 2], [0, 2], [1, 0], [4, 1], [3, 0], [2, 4]])
    bridges = bridge_candidates(6, edges, similar, {(1, 3)}, per_group=5)
    assert bridges == [(0, 4), (2, 5), (4, 5)]
    in_file_order = bridge_candidates(6, edges, np.zeros((6, 0), np.int64), set(), per_group=1)
    assert in_file_order == [(2, 3), (4, 5)]


def test_photos_lie_beside_those_that_gps_has_nearest():
    gps = [(55.0, 13.0 + 1e-4 * x, 40.0) for x in (0, 1, 3, 7)]
    told = [SimpleNamespace(gps=position) for position in (*gps, None)]
    near = nearest_by_gps(SimpleNamespace(photos=told), 2)
    assert near.tolist() == [[1, 2], [0, 2], [1, 0], [2, 1], [-1, -1]]


def test_look_alikes_and_neighbours_take_turns():
    alike, near = np.array([[1, 2], [3, 4]]), np.array([[5, 6, 7], [8, 9, 0]])
    assert _in_turn(alike, near).tolist() == [[1, 5, 2, 6, 7], [3, 8, 4, 9, 0]]
    nothing = np.zeros((0, 0), np.int64)
    assert _in_turn(nothing, near) is near
    assert _in_turn(nothing, np.full((2, 3), -1)) is nothing


def test_witnesses_are_the_untried_among_the_best_look_alikes():
    similar = np.array([[1, 2, 3, 4], [0, 2, 3, 4], [1, 0, -1, -1], [4, 1, 0, 2], [3, 1, 0, 2]])
    assert witness_pairs(similar, {(0, 1), (0, 2), (1, 2), (3, 4)}) == [(0, 3), (0, 4), (1, 3), (1, 4)]
    assert witness_pairs(np.zeros((5, 0), np.int64), set()) == []
    assert witness_pairs(np.zeros((0, 0), np.int64), set()) == []


def test_covisible_pairs_count_shared_points():
    model = dataclasses.replace(
        ring(4),
        points=np.zeros((4, 3)),
        colors=np.zeros((4, 3), np.uint8),
        errors=np.zeros(4),
        track_offsets=np.array([0, 2, 4, 7, 9]),
        track_images=np.array([0, 1, 0, 1, 0, 1, 2, 2, 3], np.int32),
        track_xy=np.zeros((9, 2)),
    )
    edges, shared = covisible_pairs(model, least=1)
    assert edges.tolist() == [[0, 1], [0, 2], [1, 2], [2, 3]]
    assert shared.tolist() == [3, 1, 1, 1]
    assert covisible_pairs(model, least=2)[0].tolist() == [[0, 1]]
