"""The whole way, from photos to report, on a small synthetic street; then what a second command does with it."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from plyfile import PlyData

import graphgs
from graphgs import cli
from graphgs.pipeline import EVALUATION, STAGES
from graphgs.scene.colmap import read_model
from graphgs.synth.street import StreetConfig, write_street

STEPS = 60
OPTIONS = ["--device", "cpu", "--threads", "2", "--preset", "preview"]
# The stages before training
EARLY = {"photos", "coarse", "pairs", "matches", "mapping", "views", "graph", "dense", "points"}
PROPERTIES = [
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(45)),
    "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
]  # fmt: skip


@pytest.fixture(scope="session")
def photos(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("street")
    return write_street(StreetConfig(frames=12, width=320, height=180), folder).images


@pytest.fixture(scope="session")
def scene(photos, tmp_path_factory) -> Path:
    """The output of one run. Tests that change it leave a finished scene behind."""
    output = tmp_path_factory.mktemp("scenes") / "scene"
    assert run(photos, output) == 0
    return output


def run(photos: Path, output: Path, steps: int = STEPS) -> int:
    return cli._guarded(["run", str(photos), str(output), *OPTIONS, "--steps", str(steps)])


def events(output: Path) -> list[dict]:
    return [json.loads(line) for line in (output / "log.jsonl").read_text().splitlines()]


def made_and_reused(output: Path) -> tuple[set[str], set[str]]:
    """Stages of the last command in this folder."""
    last = events(output)
    start = max(k for k, event in enumerate(last) if event["event"] == "run")
    stages = [event for event in last[start:] if event["event"] == "stage"]
    return {s["name"] for s in stages if not s["reused"]}, {s["name"] for s in stages if s["reused"]}


def test_every_output_is_there(scene):
    splats = PlyData.read(scene / "splat.ply")["vertex"]
    assert [p.name for p in splats.properties] == PROPERTIES
    assert all(np.isfinite(splats[name]).all() for name in PROPERTIES)
    metrics = json.loads((scene / "metrics.json").read_text())
    assert {
        "psnr", "ssim", "lpips", "views", "num_splats", "steps_executed", "images", "registered", "pairs_candidate",
        "pairs_exhaustive", "seconds", "peak_rss_mb", "device", "versions", "seed",
    } <= metrics.keys()  # fmt: skip
    assert (metrics["images"], metrics["registered"], metrics["steps_executed"]) == (12, 12, STEPS)
    assert metrics["pairs_verified"] <= metrics["pairs_candidate"] <= metrics["pairs_exhaustive"]
    assert metrics["cautions"] == []  # EXIF tells the focal length
    assert metrics["num_splats"] == len(splats)
    assert metrics["psnr"] > 10
    assert {stage.name for stage in STAGES} <= metrics["seconds"].keys()
    names = [view["name"] for view in metrics["views"]]
    assert names == ["000001.jpg", "000009.jpg"]  # every 8th
    for name in names:
        for kind in ("truth", "render", "error"):
            assert (scene / "eval" / f"{Path(name).stem}.{kind}.png").stat().st_size > 0
    graph = nx.node_link_graph(json.loads((scene / "graph.json").read_text()), edges="edges")
    assert len(graph) == 12
    assert nx.is_connected(graph)
    model = read_model(scene / "colmap" / "sparse" / "0")
    assert len(model.names) == 12
    assert {camera.model for camera in model.cameras} == {"PINHOLE"}
    assert all((scene / "colmap" / "images" / name).is_file() for name in model.names)
    assert (scene / "colmap" / "original").is_dir()
    assert list((scene / "checkpoints").iterdir())
    report = (scene / "report.html").read_text()
    assert report.rstrip().endswith("</html>")
    assert "000001.jpg" in report
    assert "steps = 60" in (scene / "run.toml").read_text()
    assert not list(scene.rglob("*.partial"))


def test_the_same_command_reuses_every_stage(photos, scene):
    before = (scene / "splat.ply").read_bytes()
    assert run(photos, scene) == 0
    assert made_and_reused(scene) == (set(), {stage.name for stage in STAGES})
    assert (scene / "splat.ply").read_bytes() == before


def test_more_steps_rerun_training_and_evaluation_alone(photos, scene):
    assert run(photos, scene, steps=80) == 0
    assert made_and_reused(scene) == ({"training", "evaluation"}, EARLY)
    assert json.loads((scene / "metrics.json").read_text())["steps_executed"] == 80


def test_eval_measures_the_same_again(scene, capsys):
    metrics = json.loads((scene / "metrics.json").read_text())
    kept = (scene / "cache" / EVALUATION.folder / "evaluation.json").read_text()
    assert cli._guarded(["eval", str(scene), "--device", "cpu"]) == 0
    assert f"{metrics['psnr']:.2f} dB" in capsys.readouterr().out
    again = json.loads((scene / "eval" / "evaluation.json").read_text())
    assert again["psnr"] == pytest.approx(metrics["psnr"], abs=1e-3)  # splat.ply holds normalised quaternions
    assert (scene / "cache" / EVALUATION.folder / "evaluation.json").read_text() == kept


@pytest.mark.parametrize(("views", "count"), [("test", 2), ("train", 10), ("all", 12)])
def test_render_writes_pictures(scene, tmp_path, views, count):
    assert cli._guarded(["render", str(scene), str(tmp_path / "out"), "--views", views, "--device", "cpu"]) == 0
    assert len(list((tmp_path / "out").glob("*.png"))) == count


def test_train_goes_on_from_the_poses_with_the_scenes_settings(scene):
    assert cli._guarded(["train", str(scene), "--steps", "30", "--set", "training.sh_degree=1"]) == 0
    made, _ = made_and_reused(scene)
    assert made == {"training", "evaluation"}
    settings = (scene / "run.toml").read_text()
    assert "steps = 30" in settings
    assert "sh_degree = 1" in settings
    assert "max_side = 640" in settings


def test_train_refuses_poses_of_other_photos(scene, tmp_path, capsys):
    """A run with other photos was killed after reading them: the poses that are left are not theirs."""
    stale = tmp_path / "scene"
    shutil.copytree(scene, stale)
    record = stale / "cache" / "01_photos" / "stage.json"
    record.write_text(json.dumps(json.loads(record.read_text()) | {"key": "of other photos"}))
    assert cli._guarded(["train", str(stale), "--steps", "5"]) == 2
    assert "belong to other photos" in capsys.readouterr().err


def test_train_reports_no_pairs_that_the_poses_were_not_made_from(scene, tmp_path):
    stale = tmp_path / "scene"
    shutil.copytree(scene, stale)
    record = stale / "cache" / "04_matches" / "stage.json"
    record.write_text(json.dumps(json.loads(record.read_text()) | {"key": "of other pairs"}))
    assert cli._guarded(["train", str(stale), "--steps", "5"]) == 0
    assert json.loads((stale / "metrics.json").read_text())["pairs_candidate"] is None


def test_python_gives_what_the_command_gives(photos, scene):
    """The same options, so every stage but training (other steps) is reused."""
    result = graphgs.run(photos, scene, preset="preview", device="cpu", threads=2, steps=20)
    assert result.status == "complete"
    assert result.metrics["steps_executed"] == 20
    assert result.splat_path.is_file()
    assert result.report_path.is_file()
    assert made_and_reused(scene)[1] == EARLY


@pytest.mark.skipif(os.name != "posix", reason="kill -9")
def test_a_killed_run_continues(photos, scene, tmp_path):
    """Killed in training, after a checkpoint; the same command reuses what was done and goes on from that step."""
    steps = 100
    output = tmp_path / "killed"
    command = [sys.executable, "-m", "graphgs", "run", str(photos), str(output), *OPTIONS, "--steps", str(steps)]
    command += ["--set", "training.checkpoint_s=0.2"]
    # The stages before training are those of the finished scene: what is tested here comes after them.
    copy_stages(scene, output)
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT)
    try:
        wait_for(lambda: checkpoint_step(output) > 0, process)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    saved = checkpoint_step(output)
    assert 0 < saved < steps
    assert not (output / "splat.ply").exists()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=300)
    assert made_and_reused(output) == ({"training", "evaluation"}, EARLY)
    assert [event["step"] for event in events(output) if event["event"] == "resumed"] == [saved]
    assert json.loads((output / "metrics.json").read_text())["steps_executed"] == steps


def copy_stages(scene: Path, output: Path) -> None:
    for stage in STAGES:
        if stage.name in EARLY:
            shutil.copytree(scene / "cache" / stage.folder, output / "cache" / stage.folder)


def checkpoint_step(output: Path) -> int:
    try:
        return json.loads((output / "checkpoints" / "latest.json").read_text())["step"]
    except (FileNotFoundError, json.JSONDecodeError):
        return 0


def wait_for(condition, process: subprocess.Popen, seconds: float = 200.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, "the run ended before it could be killed"
        assert time.monotonic() < deadline, "no checkpoint appeared"
        time.sleep(0.02)
