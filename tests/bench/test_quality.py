"""The quality benchmark on a tiny scene: it measures, goes on where it stopped, and writes what it measured."""

import argparse
import dataclasses
import json
from concurrent.futures import Future

import numpy as np
import pytest

from bench import quality, quality_inputs
from bench.quality_cases import BY_NAME, CASES, Case, unknown_setting
from bench.quality_measure import measure
from bench.quality_report import write_report
from bench.quality_scenes import Scene
from bench.quality_table import Figure, Table
from graphgs.points import DenseCloud
from graphgs.scene.reconstruction import Reconstruction
from tests.support.tiny_scene import tiny_scene

STEPS = 20


class Here:
    """Runs a worker's work in this process."""

    def __init__(self, *_, **__):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def submit(self, function, *args):
        future = Future()
        try:
            future.set_result(function(*args))
        except Exception as error:
            future.set_exception(error)
        return future


@pytest.fixture
def scene(tmp_path) -> Scene:
    (tmp_path / "photos").mkdir()
    tiny = tiny_scene(tmp_path / "photos")
    n, count = len(tiny.views.names), len(tiny.points.positions)
    model = Reconstruction(
        (), tiny.views.names, np.zeros(n, np.int64), tiny.views.viewmats[:, :3, :3], tiny.views.viewmats[:, :3, 3],
        tiny.points.positions.astype(np.float64), (255 * tiny.points.colors).astype(np.uint8), np.zeros(count),
        3 * np.arange(count + 1), np.resize(np.array([1, 2, 3, 1, 2, 5], np.int32), 3 * count),
        np.zeros((3 * count, 2)),
    )  # fmt: skip
    octree = dataclasses.replace(
        tiny.points, **{k: getattr(tiny.points, k)[::2] for k in ("positions", "colors", "scales")}
    )
    depths = {name: np.full((28, 40), 2.5, np.float32) for name in tiny.views.names}
    dense = DenseCloud(
        np.repeat(model.points, 3, axis=0) + np.random.default_rng(0).normal(0, 0.1, (3 * count, 3)),
        np.repeat(model.colors, 3, axis=0),
        np.full(3 * count, 3), np.ones(3 * count, int), np.ones(3 * count),
    )  # fmt: skip
    return Scene("fox", tiny.views, tiny.graph, model, {"octree": octree}, dense, 1.5, depths)


@pytest.fixture
def bench(scene, tmp_path, monkeypatch):
    """Run the workload on the tiny scene under the name of a set; returns its metrics."""
    monkeypatch.setattr(quality, "ProcessPoolExecutor", Here)
    monkeypatch.setattr(quality, "prepared", lambda cache: ["fox"])
    monkeypatch.setattr(quality, "prepare", lambda *_, **__: None)
    monkeypatch.setattr(quality, "load_scene", lambda *_, **__: scene)
    monkeypatch.setattr("bench.quality_measure.load_scene", lambda *_, **__: scene)

    def run(*words: str):
        parser = argparse.ArgumentParser()
        quality.add_arguments(parser)
        fixed = ["--sets", "fox", "--steps", str(STEPS), "--data", str(tmp_path / "none")]
        return quality.run("cpu", tmp_path, parser.parse_args([*fixed, *words]))

    return run


def test_a_stopped_run_goes_on_and_is_reported(bench, tmp_path, monkeypatch, capsys):
    bench("--cases", "full", "plain", "--seeds", "1")
    path = tmp_path / "quality" / "quality.jsonl"
    first = path.read_text()
    rows = [json.loads(line) for line in first.splitlines()]
    assert [(row["case"], row["steps"]) for row in rows] == [("full", STEPS), ("plain", STEPS)]
    assert all(row["psnr"] > 5 and 0 <= row["ssim"] <= 1 and row["worst"] <= row["psnr"] for row in rows)
    assert all(0 <= row["depth_error"] < 1 and row["frames_per_s"] > 0 for row in rows)

    path.write_text(first + '{"set": "fox", "ca')  # killed while it wrote
    measured = []
    monkeypatch.setattr(quality, "measure", lambda job: measured.append((job.case.name, job.seed)) or measure(job))
    metrics = bench("--cases", "full", "plain", "--seeds", "2")
    assert measured == [("full", 1), ("plain", 1)]
    assert "damaged" in capsys.readouterr().out
    rows = quality.Store(path).rows
    assert len(rows) == 4
    assert metrics[0].value == pytest.approx(np.mean([row["psnr"] for row in rows if row["case"] == "full"]))

    text = write_report(rows, tmp_path, pictures=tmp_path / "none").read_text()
    table = Table(rows)
    for case in ("full", "plain"):
        assert f"| fox | {case} | {table.figure(case, 'fox', 'psnr').text()} |" in text
    difference = table.difference("full", "plain", "fox")
    assert f"| fox | plain | {difference.text(sign=True)} | {difference.verdict}" in text


def test_tuned_cases_take_the_best_rates_and_equal_time_takes_equal_seconds(bench, tmp_path, monkeypatch):
    scores = {"plain": 20.0, "plain 0.7/1": 21.0}
    jobs = []

    def fake(job):
        jobs.append(job)
        seconds = {"full": 30.0, "plain tuned": 20.0}.get(job.case.name, 10.0)
        return {
            "set": job.set, "case": job.case.name, "seed": job.seed, "steps": job.steps,
            "psnr": scores.get(job.case.name, 19.0), "splats": 1, "seconds": seconds,
        }  # fmt: skip

    monkeypatch.setattr(quality, "measure", fake)
    bench("--cases", "full", "plain", "plain 0.7/1", "plain tuned", "plain tuned, equal time", "--seeds", "1")
    by_name = {job.case.name: job for job in jobs}
    assert by_name["plain tuned"].rates == by_name["plain tuned, equal time"].rates == (0.7, 1.0)
    assert by_name["full"].rates == (1.0, 1.0)
    assert by_name["plain tuned, equal time"].steps == 1.5 * STEPS


def test_a_failed_training_stops_no_other(bench, tmp_path, monkeypatch, capsys):
    def fake(job):
        raise ValueError("no such thing")

    monkeypatch.setattr(quality, "measure", fake)
    assert bench("--cases", "full", "plain", "--seeds", "1") == []
    assert capsys.readouterr().out.count("failed: ValueError: no such thing") == 2


def test_altered_inputs(scene, tmp_path, monkeypatch):
    def inputs(**options):
        return quality_inputs.inputs_of(Case("c", "", **options), scene, tmp_path / "altered")

    is_test = scene.views.is_test
    sparse = inputs(keep_every=2)
    assert sparse.views.names == sparse.graph.names
    assert sparse.views.is_test.sum() == is_test.sum()
    assert (~sparse.views.is_test).sum() == (~is_test).sum() // 2
    assert len(sparse.points.positions) == len(scene.model.points) // 2  # views 1, 3, 6 are left: the others see once

    assert len(inputs(points="random").points.positions) == len(scene.points["octree"].positions)
    assert len(inputs(points="all").points.positions) == len(scene.model.points)
    assert len(inputs(points="sparse").points.positions) == len(scene.model.points)
    assert len(inputs().points.positions) == 4 * len(scene.model.points)  # as the limit of 20,000 is far
    monkeypatch.setattr(quality_inputs, "JOINED", 150)
    for which, count in (("joined", 150), ("joined-octree", 60), ("joined-random", 60)):
        assert len(inputs(points=which).points.positions) == count

    for which, count in (("filled", 90), ("filled-octree", 36)):
        assert len(inputs(points=which, training={"max_splats": 90}).points.positions) == count

    moved = inputs(disturbed=True).views.viewmats
    assert (moved[is_test] == scene.views.viewmats[is_test]).all()
    assert (moved[~is_test] != scene.views.viewmats[~is_test]).any(axis=(1, 2)).all()
    assert (inputs(noise=0.3).views.viewmats != scene.views.viewmats).any(axis=(1, 2)).all()

    for options, least, most in (({"exposure_stops": 1.0}, 0.0, 1.0), ({"passers_by": 0.1}, 0.02, 0.11)):
        altered = inputs(**options).views
        for i in range(len(is_test)):
            changed = (altered.read(i)[0] != scene.views.read(i)[0]).any(axis=2).mean()
            assert changed == 0 if is_test[i] else least < changed <= most  # part of an ellipse may lie outside


def test_cases_are_named_once_and_unknown_settings_are_said():
    assert len(BY_NAME) == len(CASES)
    assert unknown_setting(BY_NAME["full"]) is None
    assert "no_such" in unknown_setting(Case("x", "", {"no_such": 1}))


def test_a_difference_is_decided_only_beyond_chance():
    assert Figure(0.5, 0.1, 3).verdict == "gains"
    assert Figure(-0.5, 0.1, 3).verdict == "loses"
    assert Figure(0.24, 0.1, 3).verdict == "undecided"  # all three seeds may agree by chance
    assert Figure(0.24, 0.1, 9).verdict == "gains"
    assert Figure(0.5, None, 1).verdict == "one seed"


def test_every_case_has_its_place_in_the_report(tmp_path):
    """Made-up measurements of everything: no case is measured that the report leaves out."""
    rng = np.random.default_rng(0)
    rows = [
        {
            "set": name, "case": case.name, "seed": seed, "base_steps": 2000, "steps": 2000, "device": "a card",
            "jobs": 8, "commit": "abc", "torch": "1", "warp": "1", "python": "3", "missing": 0, "photos": 50,
            "edges": 100, "points": 1000, "splats": 20_000, "psnr": 25 + rng.normal(), "ssim": 0.9, "worst": 20.0,
            "psnr_fitted": 26.0, "seconds": 10 + rng.random(), "frames_per_s": 100.0,
            "depth_error": 0.1 + 0.01 * rng.random() if name in ("street", "street-own", "drive") else None,
            "turn_before_deg": 0.5, "turn_after_deg": 0.1, "shift_before": 0.01, "shift_after": 0.002,
        }
        for name in quality.SETS
        for case in CASES
        for seed in range(min(3, case.seeds or 3))
        if quality.fits(case, name)
    ]  # fmt: skip
    text = write_report(rows, tmp_path, pictures=tmp_path / "none").read_text()
    told = (
        "noise",
        "every",
        "joined",
        "filled",
        "exposure",
        "passers",
        "poses",
        "plain 0",
        "plain 1",
    )  # by what they change
    assert all(f"| {case.name} |" in text for case in CASES if not case.name.startswith(told))
    assert "## Noisy poses" in text
    assert "Also measured" not in text
    assert "## Sparse views" in text
    assert "## Exposure" in text
    assert "## Passers-by" in text
    assert "## Octree" in text
    assert "## Refining poses" in text
    plots = sorted(path.name for path in (tmp_path / "pictures").iterdir())
    assert plots == ["gain.svg", "lambda.svg", "noise.svg"]
    assert all(f"pictures/{name}" in text for name in plots)


def test_another_device_has_a_page_of_its_own(tmp_path):
    row = {
        "set": "castle", "case": "full", "seed": 0, "base_steps": 2000, "steps": 2000, "jobs": 1, "commit": "abc",
        "torch": "1", "warp": "1", "python": "3", "missing": 0, "photos": 30, "edges": 90, "points": 1000,
        "splats": 20_000, "ssim": 0.9, "worst": 20.0, "psnr_fitted": 26.0, "seconds": 10.0, "frames_per_s": 100.0,
        "depth_error": None,
    }  # fmt: skip
    here = [row | {"device": "a card", "psnr": 26.25, "case": case} for case in ("full", "plain")]
    there = [row | {"device": "A CPU, 2", "psnr": 28.75}]
    text = write_report(there + here, tmp_path, pictures=tmp_path / "none").read_text()
    assert "[A CPU, 2, 2000 steps](results-a-cpu-2-2000.md)" in text
    assert "26.25" in text
    assert "28.75" not in text
    page = (tmp_path / "results-a-cpu-2-2000.md").read_text()
    assert "28.75" in page
    assert "26.25" not in page
