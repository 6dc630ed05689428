"""Checkpoints are whole or absent."""

import json

import pytest
import torch

from graphgs.errors import DiskError
from graphgs.training import checkpoint as module
from graphgs.training.checkpoint import Checkpoint, load_checkpoint, save_checkpoint


def _at(step: int) -> Checkpoint:
    return Checkpoint(step, {"values.means": torch.full((4, 3), float(step))}, {"recoveries": 0}, "run")


def test_what_is_saved_comes_back_and_the_predecessor_goes(tmp_path):
    save_checkpoint(_at(1), tmp_path, "latest")
    save_checkpoint(_at(2), tmp_path, "latest")
    loaded = load_checkpoint(tmp_path, "latest", "run")
    assert (loaded.step, loaded.extra) == (2, {"recoveries": 0})
    assert torch.equal(loaded.tensors["values.means"], torch.full((4, 3), 2.0))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["latest.json", "latest_0000002.safetensors"]


def test_names_do_not_disturb_each_other(tmp_path):
    save_checkpoint(_at(1), tmp_path, "recovery")
    save_checkpoint(_at(2), tmp_path, "latest")
    assert load_checkpoint(tmp_path, "recovery", "run").step == 1


def test_another_run_s_checkpoint_is_not_continued(tmp_path):
    save_checkpoint(_at(1), tmp_path, "latest")
    assert load_checkpoint(tmp_path, "latest", "other") is None
    assert load_checkpoint(tmp_path, "recovery", "run") is None


@pytest.mark.parametrize("stage", ["tensors", "header"])
def test_death_while_writing_leaves_the_predecessor(tmp_path, monkeypatch, stage):
    save_checkpoint(_at(1), tmp_path, "latest")
    replace = module.os.replace

    def dies(source, target):
        if str(target).endswith("safetensors" if stage == "tensors" else "json"):
            raise SystemExit
        replace(source, target)

    monkeypatch.setattr(module.os, "replace", dies)
    with pytest.raises(SystemExit):
        save_checkpoint(_at(2), tmp_path, "latest")
    assert load_checkpoint(tmp_path, "latest", "run").step == 1


@pytest.mark.parametrize("damage", ["cut tensors", "no tensors", "cut header", "odd header"])
def test_a_damaged_one_counts_as_absent(tmp_path, damage):
    save_checkpoint(_at(1), tmp_path, "latest")
    tensors, header = tmp_path / "latest_0000001.safetensors", tmp_path / "latest.json"
    match damage:
        case "cut tensors":
            tensors.write_bytes(tensors.read_bytes()[:-7])
        case "no tensors":
            tensors.unlink()
        case "cut header":
            header.write_text(header.read_text()[:-7])
        case "odd header":
            header.write_text(json.dumps([1, 2]))
    assert load_checkpoint(tmp_path, "latest", "run") is None


def test_a_full_disk_is_explained(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module.os, "replace", full)
    with pytest.raises(DiskError, match="No space left"):
        save_checkpoint(_at(1), tmp_path, "latest")
    assert not list(tmp_path.iterdir())
