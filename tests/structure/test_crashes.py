"""Workers that a signal ends: once, always at a pair, always at a photo, always."""

import signal

import numpy as np
import pytest

from graphgs.errors import GraphGSError, OutOfMemoryError
from graphgs.progress import Reporter
from graphgs.structure.cameras import shared_cameras
from graphgs.structure.colmap import ColmapWorker, WorkerDied
from graphgs.structure.config import StructureConfig
from graphgs.structure.crashes import Crash
from graphgs.structure.feature_cache import FeatureCache
from graphgs.structure.features import crashed_photos, extract_features
from graphgs.structure.matching import Matches, match_pairs
from graphgs.structure.pairing import Pairs
from graphgs.structure.prior import Prior
from tests.support.corner_scene import corner_scene
from tests.support.dying_worker import deaths, dies_of

COUNT = 6
SMALL = {"max_side": 200, "max_features": 300, "first_octave": 0}


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    return corner_scene(tmp_path_factory.mktemp("corner"), count=COUNT).photos


def matched(photos, scratch, **config) -> Matches:
    n = len(photos.photos)
    prior = Prior(
        names=photos.names,
        placed=np.zeros(n, dtype=bool),
        rotations=np.tile(np.eye(3), (n, 1, 1)),
        centers=np.full((n, 3), np.nan),
        cameras=shared_cameras(photos),
        refine=(),
        source="auto",
    )
    everything = np.stack(np.triu_indices(n, 1), axis=1)
    pairs = Pairs(photos.names, everything, np.zeros(len(everything), np.uint8), 0, 15, "none", "none", "none")
    return match_pairs(
        StructureConfig(fine_features=600, **config), photos, pairs, prior,
        scratch=scratch, reporter=Reporter(), threads=1, seed=0,
    )  # fmt: skip


@pytest.fixture(scope="module")
def undisturbed(photos, tmp_path_factory):
    return matched(photos, tmp_path_factory.mktemp("undisturbed"))


def edges_without(matches: Matches, *, pairs=(), photo=None) -> list[list[int]]:
    return [e for e in matches.edges.tolist() if e not in [list(p) for p in pairs] and photo not in e]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGABRT], ids=lambda n: n.name)
def test_a_worker_that_dies_once_costs_nothing_but_time(photos, undisturbed, tmp_path, monkeypatch, number):
    dies_of(monkeypatch, tmp_path, signal=number, pairs=[[1, 2]], once=str(tmp_path / "once"))
    found = matched(photos, tmp_path / "scratch")
    assert deaths(tmp_path) == 1
    assert found.crashes == ()
    np.testing.assert_array_equal(found.edges, undisturbed.edges)
    np.testing.assert_array_equal(found.inliers, undisturbed.inliers)


def test_a_fatal_pair_is_found_and_left_out_for_good(photos, undisturbed, tmp_path, monkeypatch):
    dies_of(monkeypatch, tmp_path, signal=signal.SIGSEGV, pairs=[[1, 2]])
    found = matched(photos, tmp_path / "scratch")
    assert found.crashes == (Crash((photos.names[1], photos.names[2]), "SIGSEGV"),)
    assert "SIGSEGV" in found.crashes[0].describe()
    assert found.edges.tolist() == edges_without(undisturbed, pairs=[(1, 2)])
    found.save(tmp_path / "saved")
    assert Matches.load(tmp_path / "saved").crashes == found.crashes
    before = deaths(tmp_path)
    assert matched(photos, tmp_path / "scratch").crashes == found.crashes  # the run that continues
    assert deaths(tmp_path) == before


def test_a_fatal_photo_is_told_from_its_pairs(photos, undisturbed, tmp_path, monkeypatch):
    dies_of(monkeypatch, tmp_path, signal=signal.SIGKILL, photos=[3])
    found = matched(photos, tmp_path / "scratch")
    assert found.crashes == (Crash((photos.names[3],), "SIGKILL"),)
    assert found.edges.tolist() == edges_without(undisturbed, photo=3)


def test_where_every_pair_is_fatal_the_machine_is(photos, tmp_path, monkeypatch):
    everything = [[i, j] for j in range(COUNT) for i in range(j)]
    monkeypatch.setattr("graphgs.structure.crashes.MOST_LOST", 1)
    dies_of(monkeypatch, tmp_path, signal=signal.SIGKILL, pairs=everything)
    with pytest.raises(OutOfMemoryError, match="'match'") as caught:
        matched(photos, tmp_path / "scratch")
    assert "close other programs" in caught.value.hint


@pytest.mark.parametrize("threads", [1, 2])
def test_a_photo_that_ends_the_search_for_features_is_left_without(photos, tmp_path, monkeypatch, threads):
    cache = FeatureCache(tmp_path / "cache")
    file = photos.photos[2].pixels
    dies_of(monkeypatch, tmp_path, signal=signal.SIGABRT, files=[file])
    options = {**SMALL, "threads": threads, "progress": lambda done, total: None, "cache": cache}
    counts = extract_features(photos, tmp_path / "features", **options)
    assert counts[2] == 0
    assert (np.delete(counts, 2) > 50).all()
    assert crashed_photos(photos, tmp_path / "features") == (Crash((photos.names[2],), "SIGABRT"),)
    before = deaths(tmp_path)
    extract_features(photos, tmp_path / "features", **options)
    assert deaths(tmp_path) == before
    monkeypatch.undo()  # with another COLMAP it is found: nothing false was kept
    assert extract_features(photos, tmp_path / "again", **options)[2] > 50


def test_a_mapping_job_is_tried_twice_and_then_named(tmp_path, monkeypatch):
    dies_of(monkeypatch, tmp_path, signal=signal.SIGSEGV, jobs=["settle"])
    with ColmapWorker(tmp_path / "worker") as worker:
        with pytest.raises(WorkerDied, match="'settle' was ended by SIGSEGV") as caught:
            worker.run("settle", database=tmp_path / "x.db")
        assert isinstance(caught.value, GraphGSError)
        assert "fine_features" in caught.value.hint
        assert deaths(tmp_path) == 2
        worker.restart(because="the test goes on")
        monkeypatch.undo()


def test_the_second_try_has_less_to_do(tmp_path, monkeypatch):
    given = []
    with ColmapWorker(tmp_path) as worker:

        def dies(job, progress, arguments):
            given.append(arguments)
            if len(given) == 1:
                raise WorkerDied("dead", hint="", by="SIGSEGV")
            return {}

        monkeypatch.setattr(worker, "_run", dies)
        worker.run("match", threads=4, chunk_pairs=64, pairs=[])
    assert given[1] == {"threads": 1, "chunk_pairs": 8, "pairs": []}
