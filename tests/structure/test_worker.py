"""The worker process: its errors, its death, its parent's death, and what a kill costs."""

import ast
import dataclasses
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from graphgs.errors import DiskError, GraphGSError
from graphgs.progress import Reporter
from graphgs.structure.cameras import shared_cameras
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.config import StructureConfig
from graphgs.structure.features import extract_features
from graphgs.structure.matching import match_pairs
from graphgs.structure.pairing import Pairs
from graphgs.structure.prior import Prior
from tests.support.corner_scene import corner_scene

ROOT = Path(__file__).resolve().parents[2]


def alive(pid):
    """Running, not a zombie that nobody has collected."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_only_the_jobs_import_pycolmap():
    importers = []
    for path in sorted((ROOT / "graphgs").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if any(name.split(".")[0] == "pycolmap" for name in names):
                importers.append(path.parent.name)
    assert set(importers) == {"colmap_jobs"}


def test_a_failing_job_is_an_error_and_the_worker_goes_on(tmp_path):
    with ColmapWorker(tmp_path) as worker:
        with pytest.raises(GraphGSError, match="'verified' failed: RuntimeError") as caught:
            worker.run("verified", database=tmp_path / "missing" / "x.db", out=tmp_path / "out.npz")
        assert "continues where it stopped" in caught.value.hint
        with pytest.raises(GraphGSError, match="unheard"):
            worker.run("unheard")
        assert worker.run("create_database", **empty_database(tmp_path)) == {}
        assert worker.peak_rss_mb > 20


def empty_database(folder):
    return {
        "database": folder / "empty.db",
        "images": [],
        "camera_of_image": [],
        "cameras": [],
        "features": folder,
    }


def test_a_worker_that_died_between_two_jobs_is_replaced(tmp_path):
    """What was written for it has no reader left; closing the pipe must not hide why."""
    with ColmapWorker(tmp_path) as worker:
        os.kill(worker.pid, signal.SIGKILL)
        worker._process.wait()
        assert worker.run("create_database", **empty_database(tmp_path)) == {}
    assert "SIGKILL" in (tmp_path / "colmap.log").read_text()


def test_a_worker_that_leaves_by_itself_is_not_replaced(tmp_path, monkeypatch):
    monkeypatch.setattr(ColmapWorker, "program", "no.such.module")
    with ColmapWorker(tmp_path) as worker, pytest.raises(GraphGSError, match="No module named") as caught:
        worker.run("create_database", **empty_database(tmp_path))
    assert caught.value.exit_code == 1
    assert "colmap.log" in caught.value.hint


def test_a_full_disk_is_named(tmp_path):
    with ColmapWorker(tmp_path) as worker:
        error = worker._failure("match", "SQLite error: database or disk is full")
    assert isinstance(error, DiskError)


def test_leaving_the_block_ends_the_worker(tmp_path):
    with pytest.raises(KeyboardInterrupt), ColmapWorker(tmp_path) as worker:
        raise KeyboardInterrupt
    assert not alive(worker.pid)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="asks the Linux kernel")
def test_the_worker_dies_with_a_killed_parent(tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from graphgs.structure.colmap import ColmapWorker\n"
        "with ColmapWorker(Path(sys.argv[1])) as worker:\n"
        "    worker.run('create_database', database=Path(sys.argv[1]) / 'e.db', images=[], camera_of_image=[],\n"
        "               cameras=[], features='.')\n"
        "    print(worker.pid, flush=True); time.sleep(60)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    child = int(parent.stdout.readline())
    assert alive(child)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    deadline = time.monotonic() + 10
    while alive(child) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not alive(child)


class KilledAfter(Exception):
    """Stands for SIGKILL: raised out of the progress report, it ends the worker where it is."""


class KillingReporter(Reporter):
    def __init__(self, note, done):
        self.note, self.done = note, done

    def progress(self, done, total, note=""):
        if note == self.note and done >= self.done:
            raise KilledAfter


class CountingReporter(Reporter):
    def __init__(self):
        self.first = {}

    def progress(self, done, total, note=""):
        self.first.setdefault(note, done)


def test_killed_features_and_matches_continue_and_give_the_same(tmp_path):
    scene = corner_scene(tmp_path / "in", count=5)
    photos, n = scene.photos, 5
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
    pairs = Pairs(photos.names, everything, np.zeros(len(everything), np.uint8), 0, 10, "none", "none", "none")
    config = StructureConfig(chunk_pairs=2)

    def match(scratch, reporter):
        return match_pairs(config, photos, pairs, prior, scratch=scratch, reporter=reporter, threads=1, seed=0)

    whole = match(tmp_path / "whole", Reporter())
    for note, done in (("features", 2), ("matching", 4)):
        with pytest.raises(KilledAfter):
            match(tmp_path / "killed", KillingReporter(note, done))
    counting = CountingReporter()
    continued = match(tmp_path / "killed", counting)
    assert counting.first["features"] == 5
    assert counting.first["matching"] >= 4
    np.testing.assert_array_equal(continued.edges, whole.edges)
    np.testing.assert_array_equal(continued.inliers, whole.inliers)
    assert not list((tmp_path / "killed").glob("database.db-*"))


def test_two_workers_find_the_same_features_as_one_and_masks_hide_theirs(tmp_path):
    scene = corner_scene(tmp_path / "in", count=2)
    (tmp_path / "in" / "masks").mkdir()
    mask = np.full((240, 320), 255, np.uint8)
    mask[:, 160:] = 0
    cv2.imwrite(str(tmp_path / "in" / "masks" / "0.png"), mask)
    first = dataclasses.replace(scene.photos.photos[0], mask="masks/0.png")
    photos = dataclasses.replace(scene.photos, photos=(first, scene.photos.photos[1]))
    found = []
    for threads in (1, 2):
        folder = tmp_path / str(threads)
        options = {"max_side": 200, "max_features": 300, "first_octave": 0}
        counts = extract_features(photos, folder, **options, threads=threads, progress=lambda done, total: None)
        found.append([np.load(folder / f"{photo.pixels}.npz") for photo in photos.photos])
        assert counts.tolist() == [len(arrays["keypoints"]) for arrays in found[-1]]
    for one, two in zip(*found, strict=True):
        assert one["keypoints"].tobytes() == two["keypoints"].tobytes()
        assert one["descriptors"].tobytes() == two["descriptors"].tobytes()
    masked, free = (arrays["keypoints"] for arrays in found[0])
    assert 20 < len(masked) < len(free)
    assert masked[:, 0].max() < 160  # px of the photo, not of the reduced image
    assert free[:, 0].max() > 250
