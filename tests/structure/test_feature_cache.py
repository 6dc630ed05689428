"""What is found once is not looked for again: features by content, matches of pairs that an earlier run had."""

import dataclasses
import os
import shutil

import numpy as np
import pytest

from graphgs.progress import Reporter
from graphgs.structure.cameras import rescaled, shared_cameras
from graphgs.structure.config import StructureConfig
from graphgs.structure.feature_cache import FeatureCache
from graphgs.structure.features import extract_features
from graphgs.structure.matching import match_pairs
from graphgs.structure.pairing import Pairs
from graphgs.structure.prior import Prior
from tests.support.corner_scene import corner_scene

N = 5
CONFIG = StructureConfig(fine_features=500, chunk_pairs=2)


class Counting(Reporter):
    """What had been done already when a kind of work began."""

    def __init__(self):
        self.first = {}

    def progress(self, done, total, note=""):
        self.first.setdefault(note, done)


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    return corner_scene(tmp_path_factory.mktemp("corner"), count=N).photos


def prior_of(photos):
    n = len(photos.photos)
    return Prior(
        names=photos.names,
        placed=np.zeros(n, dtype=bool),
        rotations=np.tile(np.eye(3), (n, 1, 1)),
        centers=np.full((n, 3), np.nan),
        cameras=shared_cameras(photos),
        refine=(),
        source="auto",
    )


def pairs_of(photos, span):
    """Every pair of photos at most `span` apart in file order."""
    pairs = np.array([(i, j) for i in range(N) for j in range(i + 1, min(N, i + span + 1))])
    return Pairs(photos.names, pairs, np.zeros(len(pairs), np.uint8), 0, 10, "none", "none", "none")


def match(photos, span, scratch, *, prior=None, config=CONFIG, reporter=None, **stores):
    run = {"reporter": reporter or Reporter(), "threads": 1, "seed": 0}
    return match_pairs(
        config, photos, pairs_of(photos, span), prior or prior_of(photos), scratch=scratch, **run, **stores
    )


def test_features_survive_other_pairs_and_other_names(photos, tmp_path):
    cache = FeatureCache(tmp_path / "cache")
    first = match(photos, 4, tmp_path / "first", cache=cache)
    shutil.copytree(photos.folder, tmp_path / "in")
    renamed = []
    for photo in photos.photos:
        pixels = photo.pixels.replace(".png", "_again.png")
        (tmp_path / "in" / photo.pixels).rename(tmp_path / "in" / pixels)
        renamed.append(dataclasses.replace(photo, pixels=pixels))
    moved = dataclasses.replace(photos, folder=tmp_path / "in", photos=tuple(renamed))
    counting = Counting()
    second = match(moved, 4, tmp_path / "second", cache=cache, reporter=counting)
    assert counting.first["features"] == N
    np.testing.assert_array_equal(second.inliers, first.inliers)
    assert second.basis == first.basis


def test_features_of_another_picture_mask_or_setting_are_others(photos, tmp_path):
    cache = FeatureCache(tmp_path / "cache")
    settings = {"max_side": 320, "max_features": 500, "first_octave": 0}
    first, second = photos.photos[:2]
    shutil.copytree(photos.folder, tmp_path / "in")
    shutil.copyfile(tmp_path / "in" / second.pixels, tmp_path / "in" / "mask.png")
    moved = dataclasses.replace(photos, folder=tmp_path / "in")
    paths = [
        cache.path(moved, first, settings),
        cache.path(moved, second, settings),
        cache.path(moved, dataclasses.replace(first, mask="mask.png"), settings),
        cache.path(moved, first, {**settings, "max_features": 501}),
        cache.path(moved, first, {**settings, "first_octave": -1}),
    ]
    assert len(set(paths)) == 5
    assert cache.path(photos, first, settings) == paths[0]


def test_what_a_stopped_extraction_had_is_kept(photos, tmp_path):
    class Stopped(Exception):
        pass

    def stop(done, total):
        if done >= 2:
            raise Stopped

    cache = FeatureCache(tmp_path / "cache")
    options = {"max_side": 320, "max_features": 500, "first_octave": 0, "threads": 1, "cache": cache}
    with pytest.raises(Stopped):
        extract_features(photos, tmp_path / "first", **options, progress=stop)
    begun = []
    extract_features(photos, tmp_path / "second", **options, progress=lambda done, total: begun.append(done))
    assert begun[0] >= 2


def test_the_cache_drops_what_was_used_the_longest_ago(tmp_path):
    cache = FeatureCache(tmp_path / "cache", largest_bytes=250)
    for age, name in ((30, "old"), (20, "middle"), (10, "new")):
        file = tmp_path / "cache" / f"{name}.npz"
        file.write_bytes(bytes(100))
        os.utime(file, (1e9 - age, 1e9 - age))
    assert cache.take(tmp_path / "cache" / "old.npz", tmp_path / "taken.npz")
    cache.prune()
    assert sorted(f.stem for f in (tmp_path / "cache").iterdir()) == ["new", "old"]
    assert (tmp_path / "taken.npz").stat().st_size == 100


def test_pairs_matched_before_are_carried_over_and_change_nothing(photos, tmp_path):
    fresh = match(photos, 2, tmp_path / "fresh")
    wide = match(photos, 3, tmp_path / "wide")
    wide.save(tmp_path / "earlier")
    counting = Counting()
    carried = match(photos, 2, tmp_path / "carried", earlier=tmp_path / "earlier", reporter=counting)
    assert counting.first["matching"] == len(pairs_of(photos, 2).pairs)
    np.testing.assert_array_equal(carried.edges, fresh.edges)
    np.testing.assert_array_equal(carried.inliers, fresh.inliers)
    wider = match(photos, 4, tmp_path / "wider", earlier=tmp_path / "earlier", reporter=(counting := Counting()))
    assert counting.first["matching"] == len(pairs_of(photos, 3).pairs)
    np.testing.assert_array_equal(wider.edges, match(photos, 4, tmp_path / "all").edges)


def test_matches_made_otherwise_are_not_carried_over(photos, tmp_path):
    match(photos, 2, tmp_path / "first").save(tmp_path / "earlier")
    prior = prior_of(photos)
    other_focal = dataclasses.replace(prior, cameras=rescaled(prior.cameras, 1.1))
    stricter = dataclasses.replace(CONFIG, min_inliers=40)
    for k, changed in enumerate(({"prior": other_focal}, {"config": stricter})):
        counting = Counting()
        match(photos, 2, tmp_path / str(k), earlier=tmp_path / "earlier", reporter=counting, **changed)
        assert counting.first["matching"] == 0
