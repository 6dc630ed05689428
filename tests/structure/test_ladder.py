"""Which steps of the ladder are climbed when the earlier ones fail: a stand-in answers for COLMAP."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photo, Photos
from graphgs.structure.cameras import shared_cameras
from graphgs.structure.config import StructureConfig
from graphgs.structure.contradictions import PairSupport
from graphgs.structure.evidence import VerifiedMatches
from graphgs.structure.ladder import climb
from graphgs.structure.matching import Matches
from graphgs.structure.model_calls import ModelCalls
from graphgs.structure.prior import Prior, poses_by_name
from graphgs.structure.soundness import Soundness, Witness

N = 24


def photos_of(folder, focal_px=None, n=N):
    photo = Photo("", "", 320, 240, 320, 240, None, focal_px, "one", "", None, None)
    return Photos(
        folder,
        tuple(dataclasses.replace(photo, name=f"{k:02d}.jpg", pixels=f"photos/{k:02d}.png") for k in range(n)),
    )


def poses(photos, *, count=N, wrong=0.0):
    """A bent line of cameras, by pixel file; `wrong` moves one of them, in units of the spacing."""
    centers = np.stack([np.arange(count), 0.1 * np.arange(count) ** 1.5, np.zeros(count)], 1)
    centers[count // 2] += wrong
    return Reconstruction(
        cameras=(Camera("SIMPLE_RADIAL", 320, 240, (300.0, 160.0, 120.0, 0.0)),),
        names=tuple(photo.pixels for photo in photos.photos[:count]),
        camera_ids=np.zeros(count, np.int64),
        rotations=np.tile(np.eye(3), (count, 1, 1)),
        translations=-centers,
        errors=np.full(5, 0.5),
    )


class ColmapStandIn:
    """Answers each mapping job with what `models` says about it: `right`, `wrong`, `fewer`, or nothing."""

    def __init__(self, photos, answers):
        self.photos, self.answers, self.asked = photos, answers, []

    def run(self, job, **arguments):
        if job == "match":
            self.pairs = arguments["pairs"]
            return {"matched_now": len(self.pairs)}
        if job == "halve":
            return {}
        if job == "verified":
            edges = np.unique(np.array(self.pairs), axis=0)
            np.savez(arguments["out"], edges=edges, inliers=np.full(len(edges), 50))
            return {}
        step = arguments["out"].relative_to(self.photos.folder).as_posix()
        self.asked.append(step)
        answer = self.answers(step)
        if answer:
            kinds = {"right": {}, "wrong": {"wrong": 6.0}, "wrong_too": {"wrong": -6.0}, "fewer": {"count": N // 3}}
            poses(self.photos, **kinds[answer]).save(arguments["out"])
        return {}


class NoDoubts:
    """Stands for the verified matches as witnesses: they contradict no model."""

    photos = SimpleNamespace(names=())
    verified = VerifiedMatches(np.zeros((0, 2), np.int64), np.zeros(1, np.int64), *np.zeros((2, 0, 2), np.float32))

    def judge(self, model):
        none = np.zeros(0, np.int64)
        sound = Soundness(0.0, 0.0, None, 0, 0.0, False, 100, ())
        return sound, PairSupport(none.reshape(0, 2), none, none, none)


@pytest.fixture(autouse=True)
def _without_doubts(monkeypatch):
    monkeypatch.setattr(Witness, "of", lambda *_, **__: NoDoubts())


def climbed(tmp_path, answers, *, config=None, focal_px=None):
    """(best candidate, steps asked for) on a chain of matches."""
    tmp_path.mkdir(exist_ok=True)
    photos = photos_of(tmp_path, focal_px)
    coarse = dataclasses.replace(poses(photos), names=photos.names)
    placed, rotations, centers = poses_by_name(photos.names, coarse)
    similar = np.stack([(np.arange(N) + 7) % N, (np.arange(N) + 11) % N], 1)
    prior = Prior(
        photos.names, placed, rotations, centers, shared_cameras(photos), (), "auto",
        reconstruction=coarse, similar=similar,
    )  # fmt: skip
    chain = np.stack([np.arange(N - 1), np.arange(1, N)], 1)
    (tmp_path / "database.db").write_bytes(b"")
    matches = Matches(photos.names, tmp_path / "database.db", chain, np.full(N - 1, 50), np.full(N, 900), N - 1)
    worker = ColmapStandIn(photos, answers)
    calls = ModelCalls(config or StructureConfig(), photos, matches, prior, worker, tmp_path, Reporter(), 1, 0)
    return climb(calls, coarse), worker.asked


FIRST = ["1_triangulated_wide", "1_triangulated"]
FIRST_THREE = [
    *FIRST, "3_incremental", "3_adjusted_wide", "3_adjusted", "3_half_0", "3_half_1",
]  # fmt: skip


def wrong_twice(step):
    """Runs that do not agree with the coarse reconstruction, and halves that do not agree with each other."""
    return "wrong_too" if "half_1" in step else "wrong"


def test_the_first_step_is_enough_where_it_is_accepted(tmp_path):
    best, asked = climbed(tmp_path, lambda step: "right")
    assert best.accepted
    assert asked == FIRST


def test_more_pairs_come_after_the_first_three_steps(tmp_path):
    best, asked = climbed(tmp_path, lambda step: "right" if step.startswith("4_") else wrong_twice(step))
    assert asked == [*FIRST_THREE, *(f"4_more_pairs/{step}" for step in FIRST)]
    assert best.accepted
    assert best.method == "triangulated from coarse poses, more pairs"
    edges = {tuple(edge) for edge in best.calls.matches.edges.tolist()}
    assert {(0, 7), (0, 11)} <= edges  # look-alikes
    assert {(0, k) for k in range(1, 11)} <= edges  # the ten nearest
    assert best.calls.matches.database == tmp_path / "4_more_pairs" / "database.db"


def test_a_global_reconstruction_needs_focal_lengths_that_are_known(tmp_path):
    def only_global(step):
        return "right" if "5_" in step else wrong_twice(step)

    best, asked = climbed(tmp_path / "known", only_global, focal_px=300.0)
    assert asked[-3:] == [f"4_more_pairs/5_{step}" for step in ("global", "adjusted_wide", "adjusted")]
    assert best.method == "global, focal lengths known"
    assert best.accepted
    best, asked = climbed(tmp_path / "guessed", only_global)
    assert not any("5_" in step for step in asked)
    assert not best.accepted


def test_halves_that_agree_with_it_and_each_other_uphold_the_incremental_model(tmp_path):
    best, asked = climbed(tmp_path, lambda step: "wrong" if step.startswith("3_") else "wrong_too")
    assert asked == FIRST_THREE
    assert best.accepted
    assert best.method == "incremental, confirmed by both halves"
    assert best.compared_with == "half of the tracks alone"


def test_halves_that_differ_uphold_nothing(tmp_path):
    best, asked = climbed(tmp_path, lambda step: wrong_twice(step) if "3_" in step else "wrong_too")
    assert asked[: len(FIRST_THREE)] == FIRST_THREE
    assert not best.accepted


def test_every_pair_is_the_last_step(tmp_path):
    best, asked = climbed(tmp_path, lambda step: "right" if "6_" in step else wrong_twice(step))
    assert asked[-1] == "4_more_pairs/6_every_pair/1_triangulated"
    assert best.method == "triangulated from coarse poses, every pair"
    assert len(best.calls.matches.edges) == N * (N - 1) // 2


def test_the_most_photos_win_where_nothing_is_accepted(tmp_path):
    best, _ = climbed(tmp_path, lambda step: "wrong_too" if step.endswith("3_adjusted") else "fewer")
    assert not best.accepted
    assert best.name == "3_adjusted"
    assert len(best.reconstruction.names) == N


def test_steps_that_give_nothing_end_in_nothing(tmp_path):
    best, asked = climbed(tmp_path, lambda step: None)
    assert best is None
    assert asked[0] == "1_triangulated_wide"


@pytest.mark.parametrize("mapper", ["incremental", "global"])
def test_a_baseline_mapper_is_one_call_and_judged_alike(tmp_path, mapper):
    config = StructureConfig(mapper=mapper)
    best, asked = climbed(tmp_path / "right", lambda step: "right", config=config)
    assert asked == [mapper]
    assert best.accepted
    best, asked = climbed(tmp_path / "wrong", lambda step: "wrong", config=config)
    assert asked == [mapper]
    assert not best.accepted
