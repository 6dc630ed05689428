"""What `graphgs explain` says, from artefacts made up by hand: a scene of 9 placed photos and 4 others."""

import json
from pathlib import Path

import numpy as np
import pytest

from graphgs import cli
from graphgs.errors import UsageError
from graphgs.explain import find_photo, photo_facts, read_artefacts, scene_facts
from graphgs.graph import CameraGraph
from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos, Skipped
from graphgs.stages import EVALUATION, GRAPH, MAPPING, MATCHES, PAIRS, PHOTOS, VIEWS
from graphgs.structure.acceptance import Agreement
from graphgs.structure.contradictions import PairSupport
from graphgs.structure.diagnosis import Diagnosis
from graphgs.structure.evidence import TriedPairs
from graphgs.structure.grouping import Grouping
from graphgs.structure.groups import Bridge, Group
from graphgs.structure.left_out import LeftOut
from graphgs.structure.pair_set import CONNECTION, NEIGHBOUR, RING
from graphgs.structure.pairing import Pairs
from graphgs.structure.result import Structure
from graphgs.structure.soundness import Soundness
from tests.support.corner_scene import photo

PLACED = tuple(f"day/{k:03d}.jpg" for k in range(9))
OTHERS = ("night/100.jpg", "night/101.jpg", "soft.jpg", "wall.jpg")
NAMES = PLACED + OTHERS
# A path 0-1-...-5, a triangle 6-7-8, and the one pair 5-6 between them; 0-12 was tried in vain.
EDGES = np.array([[0, 1], [0, 2], [1, 2], [2, 3], [2, 4], [3, 4], [3, 5], [4, 5], [5, 6], [6, 7], [6, 8], [7, 8]])


def save(folder: Path, stage, artefact, key: str, inputs: list[str]) -> None:
    target = folder / "cache" / stage.folder
    target.mkdir(parents=True)
    artefact.save(target)
    (target / "stage.json").write_text(json.dumps({"key": key, "inputs": inputs, "seconds": 1.0}))


@pytest.fixture
def scene(tmp_path) -> Path:
    n, m = len(NAMES), len(PLACED)
    photos = Photos(tmp_path, tuple(photo(name, name) for name in NAMES), (Skipped("half.jpg", "cut short"),))
    model = Reconstruction(
        cameras=(Camera.pinhole(320, 240, 260, 260, 160, 120),),
        names=PLACED,
        camera_ids=np.zeros(m, np.int64),
        rotations=np.tile(np.eye(3), (m, 1, 1)),
        translations=-np.stack([np.arange(m), np.zeros(m), np.zeros(m)], axis=1),
    )
    inliers = np.full(len(EDGES), 100)
    inliers[8] = 20
    points = np.array([300] * 7 + [30, 300] + [0] * 4)
    diagnosis = Diagnosis(
        names=NAMES,
        sharpness=np.r_[np.full(m, 20.0), [20, 20, 2, 1]],
        contrast=np.full(n, 50.0),
        edge_px=np.full(n, 1.0),
        features=np.full(n, 1000),
        points=points,
        error_px=np.r_[np.full(m, 0.5), np.full(4, np.nan)],
        tried=TriedPairs(
            np.concatenate([EDGES, [[0, 12], [9, 10]]]), np.r_[inliers + 30, 9, 80], np.r_[inliers, 0, 60]
        ),
        support=PairSupport(EDGES, inliers, inliers - 5, np.full(len(EDGES), 5)),
        objections=np.zeros((0, 2), np.int64),
        soundness=Soundness(0.05, 0.1, (PLACED[0], PLACED[1]), 5, 0.0, False, 900, ()),
        left_out=(
            LeftOut("night/100.jpg", "tiny group", "shares features with night/101.jpg alone"),
            LeftOut("night/101.jpg", "tiny group", "shares features with night/100.jpg alone"),
            LeftOut("soft.jpg", "blur", "blurred"),
            LeftOut("wall.jpg", "no overlap", "no overlap"),
        ),
    )
    groups = (Group("day", PLACED), Group("night", OTHERS[:2], Bridge(PLACED[3], "night/100.jpg", 11)))
    grouping = Grouping(groups, OTHERS[2:], 2, 2)
    structure = Structure(
        model, EDGES, inliers, True, "by hand", Agreement(9, 0.2, 0.7, 0.004), "the coarse reconstruction", grouping,
        tuple((entry.name, entry.reason) for entry in diagnosis.left_out), diagnosis=diagnosis,
        cautions=("the focal length is open",),
    )  # fmt: skip
    is_test = photos.is_test[:m]
    kinds = np.full(len(EDGES) - 1, NEIGHBOUR, np.uint8)
    kinds[0] |= CONNECTION
    kinds[1] = RING
    listed = np.delete(EDGES, 8, axis=0)  # 5-6 came later
    save(tmp_path, PHOTOS, photos, "p", [])
    save(tmp_path, PAIRS, Pairs(NAMES, listed, kinds, 0, 78, "paper", "frustum", "sequence"), "q", ["c"])
    record = tmp_path / "cache" / MATCHES.folder / "stage.json"
    record.parent.mkdir()
    record.write_text(json.dumps({"key": "m", "inputs": ["p", "c", "q"], "seconds": 1.0}))
    save(tmp_path, MAPPING, structure, "s", ["p", "c", "m"])
    graph = CameraGraph(PLACED, model.rotations, model.centers, EDGES, inliers, is_test)
    save(tmp_path, GRAPH, graph, "g", ["p", "q", "s"])
    record = tmp_path / "cache" / VIEWS.folder / "stage.json"
    record.parent.mkdir()
    record.write_text(json.dumps({"key": "v", "inputs": ["p", "s"], "seconds": 1.0}))
    return tmp_path


def evaluated(scene: Path, inputs: list[str]) -> None:
    folder = scene / "cache" / EVALUATION.folder
    folder.mkdir()
    (folder / "stage.json").write_text(json.dumps({"key": "e", "inputs": inputs, "seconds": 1.0}))
    (folder / "evaluation.json").write_text(json.dumps({"views": [{"name": PLACED[0], "psnr": 27.5, "ssim": 0.9}]}))


def test_the_scene_in_plain_values(scene):
    facts = scene_facts(read_artefacts(scene))
    assert (facts["photos"], facts["placed"], facts["accepted"]) == (13, 9, True)
    assert facts["agreement"]["rotation_p99_deg"] == 0.7
    assert [(entry["name"], entry["cause"]) for entry in facts["left_out"]][2] == ("soft.jpg", "blur")
    assert facts["groups"][1]["bridge"]["here"] == "day/003.jpg"
    assert facts["skipped"] == [{"name": "half.jpg", "reason": "cut short"}]
    assert facts["cut_pairs"] == [["day/005.jpg", "day/006.jpg"]]
    weakest = facts["weakest"][0]
    assert (weakest["name"], weakest["because"], weakest["points"]) == ("day/007.jpg", "few points", 30)
    assert weakest["weakness"] == 10.0
    assert facts["cautions"] == ["the focal length is open"]
    json.dumps(facts, allow_nan=False)


def test_a_placed_photo_and_its_pairs(scene):
    found = read_artefacts(scene)
    facts = photo_facts(found, "day/002.jpg")
    assert (facts["role"], facts["placed"], facts["reason"]) == ("training", True, None)
    assert facts["center"] == [2, 0, 0]
    assert facts["direction"] == [0, 0, 1]
    assert facts["group"] == "day"
    assert 1 <= facts["importance_rank"] <= 9
    by_name = {pair["name"]: pair for pair in facts["pairs"]}
    assert set(by_name) == {f"day/{k:03d}.jpg" for k in (0, 1, 3, 4)}
    assert by_name["day/000.jpg"]["why"] == ["ring"]
    assert (by_name["day/000.jpg"]["inliers"], by_name["day/000.jpg"]["supported"]) == (100, 95)
    pairs = photo_facts(found, "day/000.jpg")["pairs"]
    assert pairs[0]["why"] == ["neighbour", "connection"]
    assert (pairs[-1]["name"], pairs[-1]["inliers"], pairs[-1]["matches"]) == ("wall.jpg", 0, 9)
    assert pairs[-1]["supported"] is None
    later = {pair["name"]: pair["why"] for pair in photo_facts(found, "day/005.jpg")["pairs"]}
    assert "came later" in later["day/006.jpg"][0]
    json.dumps(facts, allow_nan=False)


def test_photos_without_a_pose(scene):
    found = read_artefacts(scene)
    facts = photo_facts(found, "soft.jpg")
    assert (facts["placed"], facts["cause"], facts["sharpness"]) == (False, "blur", 2.0)
    assert "center" not in facts
    assert photo_facts(found, "night/100.jpg")["pairs"][0]["name"] == "night/101.jpg"
    assert photo_facts(found, "half.jpg")["reason"] == "cut short"


def test_held_out_scores_count_only_if_they_belong_to_these_poses(scene):
    evaluated(scene, ["v", "t"])
    assert photo_facts(read_artefacts(scene), PLACED[0])["psnr"] == 27.5
    record = scene / "cache" / EVALUATION.folder / "stage.json"
    record.write_text(json.dumps({"key": "e", "inputs": ["of other views"], "seconds": 1.0}))
    assert photo_facts(read_artefacts(scene), PLACED[0])["psnr"] is None


@pytest.mark.parametrize(
    ("wanted", "name"),
    [("day/003.jpg", "day/003.jpg"), ("003.jpg", "day/003.jpg"), ("soft", "soft.jpg"), ("half", "half.jpg")],
)
def test_a_name_may_be_cut(scene, wanted, name):
    assert find_photo(read_artefacts(scene), wanted) == name


@pytest.mark.parametrize(
    ("wanted", "words", "hint"),
    [
        ("00.jpg", "2 photos end so: day/000.jpg, night/100.jpg", "more of the name"),
        ("day/03.jpg", "no photo of that name", "day/003.jpg"),
        ("zzz", "no photo of that name", "names look like day/000.jpg"),
    ],
)
def test_an_unknown_name_is_answered_with_close_ones(scene, wanted, words, hint):
    with pytest.raises(UsageError) as caught:
        find_photo(read_artefacts(scene), wanted)
    assert words in caught.value.message
    assert hint in caught.value.hint


def test_the_command_line(scene, capsys):
    assert cli._guarded(["explain", str(scene)]) == 0
    text = capsys.readouterr().out
    for words in (
        "9 of 13 photos placed",
        "caution: the focal length is open",
        "0.70° (99 %)",
        "night: 2 photos",
        "take photos from day/003.jpg to night/100.jpg",
    ):
        assert words in text
    for words in ("soft.jpg: blurred", "half.jpg: cut short", "day/007.jpg: few points (10.0 times worse)"):
        assert words in text
    assert "day/005.jpg with day/006.jpg" in text
    assert cli._guarded(["explain", str(scene), "000.jpg"]) == 0
    text = capsys.readouterr().out
    assert "day/000.jpg: placed, test view" in text
    assert "held out from training: not measured" in text
    assert "day/001.jpg: 100 matches (neighbour, connection)" in text
    assert "wall.jpg (9)" in text
    assert cli._guarded(["explain", str(scene), "wall.jpg", "--json"]) == 0
    event = json.loads(capsys.readouterr().out)
    assert (event["event"], event["name"], event["cause"]) == ("photo", "wall.jpg", "no overlap")


def test_poses_that_came_with_points_have_no_diagnosis(scene):
    (scene / "cache" / MAPPING.folder / "diagnosis.json").unlink()
    found = read_artefacts(scene)
    facts = scene_facts(found)
    assert facts["weakest"] == []
    assert facts["left_out"][0]["reason"] == "shares features with night/101.jpg alone"
    pairs = photo_facts(found, "day/005.jpg")["pairs"]
    assert (pairs[-1]["name"], pairs[-1]["inliers"]) == ("day/006.jpg", 20)


@pytest.mark.parametrize(
    ("log", "words"),
    [
        ("", "no scene there"),
        ('{"event": "run"}\n{"event": "stopped", "message": "no two photos match"}\n', "stopped: no two photos match"),
        ('{"event": "stopped", "message": "old"}\n{"event": "run"}\n{"event": "sta', "it got as far as 'photos'"),
    ],
)
def test_a_scene_that_has_not_got_that_far(tmp_path, capsys, log, words):
    if log:
        (tmp_path / "log.jsonl").write_text(log)
    if "photos" in words and "match" not in words:
        save(tmp_path, PHOTOS, Photos(tmp_path, (photo("a", "a"),)), "p", [])
    assert cli._guarded(["explain", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert "old" not in said
    assert not (tmp_path / "cache" / "lock").exists()  # nothing is written


def test_poses_of_other_photos_are_refused(scene):
    record = scene / "cache" / PHOTOS.folder / "stage.json"
    record.write_text(json.dumps(json.loads(record.read_text()) | {"key": "newer"}))
    with pytest.raises(UsageError, match="belong to other photos"):
        read_artefacts(scene)
