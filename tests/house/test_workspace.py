"""Artefacts under keys: what is reused, what runs again, what a crash leaves."""

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from graphgs.errors import UsageError
from graphgs.progress import Reporter
from graphgs.workspace import Stage, Workspace, atomic, digest, write_text

FIRST, SECOND = Stage(1, "first", 1), Stage(2, "second", 1)


@dataclass(frozen=True)
class Note:
    text: str

    def save(self, folder: Path) -> None:
        (folder / "note.txt").write_text(self.text)

    @staticmethod
    def load(folder: Path) -> "Note":
        return Note((folder / "note.txt").read_text())


@pytest.fixture
def workspace(tmp_path):
    with Workspace(tmp_path / "out") as workspace:
        yield workspace


def run(workspace: Workspace, stage: Stage, *, settings=0, inputs=(), text="made", produce=None, **more):
    """(outcome, whether the stage worked)."""
    calls = []

    def make(folder: Path, scratch: Path) -> Note:
        calls.append(scratch)
        return produce(folder, scratch) if produce else Note(text)

    outcome = workspace.run(
        stage, settings=settings, inputs=list(inputs), produce=make, load=Note.load, reporter=Reporter(), **more
    )
    return outcome, bool(calls)


def test_an_unchanged_stage_is_reused(workspace):
    first, worked = run(workspace, FIRST, text="one")
    again, worked_again = run(workspace, FIRST, text="two")
    assert worked
    assert not worked_again
    assert again.reused
    assert again.artefact == first.artefact == Note("one")
    assert (again.key, again.seconds) == (first.key, first.seconds)


def test_a_change_reruns_only_what_follows(workspace):
    first, _ = run(workspace, FIRST)
    second, _ = run(workspace, SECOND, inputs=[first.key])
    assert not run(workspace, FIRST)[1]
    changed, worked = run(workspace, SECOND, inputs=[first.key], settings=1)
    assert worked
    assert changed.key != second.key
    other, _ = run(workspace, FIRST, settings=1)
    assert other.key != first.key
    assert run(workspace, SECOND, inputs=[other.key], settings=1)[1]
    newer = dataclasses.replace(SECOND, version=2)
    assert run(workspace, newer, inputs=[other.key], settings=1)[1]


def test_a_crash_leaves_no_artefact_and_keeps_the_scratch(workspace):
    def crash(folder: Path, scratch: Path) -> Note:
        (folder / "half.txt").write_text("half")
        (scratch / "progress").write_text("7")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(workspace, FIRST, produce=crash)
    assert workspace.find(FIRST) is None

    def go_on(folder: Path, scratch: Path) -> Note:
        assert not (folder / "half.txt").exists()
        return Note((scratch / "progress").read_text())

    outcome, _ = run(workspace, FIRST, produce=go_on)
    assert outcome.artefact == Note("7")
    assert sorted(p.name for p in workspace.cache.iterdir()) == ["01_first", "lock"]


def test_another_key_gets_an_empty_scratch(workspace):
    scratch = workspace.output / "checkpoints"

    def leave(folder: Path, scratch: Path) -> Note:
        assert not (scratch / "progress").exists()
        (scratch / "progress").write_text("7")
        return Note("")

    run(workspace, FIRST, produce=leave, scratch=scratch)
    assert (scratch / "progress").exists()  # one of its own stays
    run(workspace, FIRST, settings=1, produce=leave, scratch=scratch)


@pytest.mark.parametrize("damage", ["", "[]", "{}", '{"key": 1', "\x00\xff"])
def test_a_damaged_record_is_no_artefact(workspace, damage):
    run(workspace, FIRST, text="one")
    (workspace.cache / FIRST.folder / "stage.json").write_bytes(damage.encode("latin-1"))
    assert workspace.find(FIRST) is None
    assert run(workspace, FIRST, text="two")[0].artefact == Note("two")


def test_an_artefact_of_another_version_is_not_read(workspace):
    run(workspace, FIRST)
    assert workspace.find(FIRST) is not None
    assert workspace.find(dataclasses.replace(FIRST, version=FIRST.version + 1)) is None


def test_a_deletion_cut_short_leaves_nothing_that_looks_whole(workspace, monkeypatch):
    run(workspace, FIRST, text="one")

    def killed(folder) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("graphgs.workspace.shutil.rmtree", killed)
    with pytest.raises(KeyboardInterrupt):
        run(workspace, FIRST, settings=1)
    assert workspace.find(FIRST) is None


def test_one_run_at_a_time(tmp_path):
    first = Workspace(tmp_path / "out")
    with pytest.raises(UsageError, match="another graphgs run"):
        Workspace(tmp_path / "out")
    first.close()
    Workspace(tmp_path / "out").close()


def test_a_file_is_the_old_one_or_the_whole_new_one(tmp_path):
    path = tmp_path / "file.txt"
    write_text(path, "old")

    def fail() -> None:
        with atomic(path) as partial:
            partial.write_text("ne")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_text() == "old"
    write_text(path, "new")
    assert path.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["file.txt"]


def test_keys_do_not_depend_on_the_order_of_names():
    assert digest({"a": 1, "b": 2}) == digest(json.loads('{"b": 2, "a": 1}'))
    assert digest({"a": 1}) != digest({"a": 2})
