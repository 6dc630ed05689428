"""The stage on folders of photos: what is read, what is named and skipped, what is written."""

import hashlib
import os
import struct

import cv2
import numpy as np
import pytest
from PIL import Image

from graphgs.errors import DataError, DiskError, UsageError
from graphgs.progress import Reporter
from graphgs.sources import Photos, SourcesConfig, fingerprint, load_photos, scan
from tests.support.pictures import picture, write_photos


class Notes(Reporter):
    def __init__(self):
        self.warnings, self.done, self.events = [], [], {}

    def warn(self, message):
        self.warnings.append(message)

    def progress(self, done, total, note=""):
        self.done.append((done, total))

    def event(self, kind, **fields):
        self.events[kind] = fields


def load(source, folder, *, side=1600, threads=2, reporter=None, **options) -> Photos:
    reporter = reporter or Reporter()
    return load_photos(SourcesConfig(side), source, folder, reporter=reporter, threads=threads, **options)


def test_photos_are_decoded_and_described(tmp_path):
    names = write_photos(tmp_path / "in", 10)
    notes = Notes()
    photos = load(tmp_path / "in", tmp_path / "out", side=24, reporter=notes)
    assert photos.names == tuple(names)
    assert photos.is_test.tolist() == [True] + [False] * 7 + [True, False]
    first = photos.photos[0]
    assert (first.pixels, first.width, first.height) == ("photos/000000.png", 24, 20)
    assert (first.original_width, first.original_height) == (48, 40)
    assert first.sha256 == hashlib.sha256((tmp_path / "in/0000.png").read_bytes()).hexdigest()
    written = cv2.imread(str(tmp_path / "out" / first.pixels), cv2.IMREAD_UNCHANGED)[..., ::-1]
    np.testing.assert_array_equal(written, cv2.resize(picture(0), (24, 20), interpolation=cv2.INTER_AREA))
    assert notes.done == [(i, 10) for i in range(1, 11)]
    assert notes.events["photos"]["usable"] == 10


def test_save_and_load(tmp_path):
    write_photos(tmp_path / "in", 3)
    (tmp_path / "in/x.jpg").write_text("words")
    photos = load(tmp_path / "in", tmp_path / "out")
    photos.save(tmp_path / "out")
    back = Photos.load(tmp_path / "out")
    assert (back.folder, back.photos, back.skipped) == (tmp_path / "out", photos.photos, photos.skipped)
    assert back.given is None


def test_the_number_of_threads_changes_nothing(tmp_path):
    write_photos(tmp_path / "in", 7, suffix="jpg")
    one, four = (load(tmp_path / "in", tmp_path / str(n), threads=n) for n in (1, 4))
    assert one.photos == four.photos
    for photo in one.photos:
        assert (tmp_path / "1" / photo.pixels).read_bytes() == (tmp_path / "4" / photo.pixels).read_bytes()


def test_bad_files_are_named_and_skipped(tmp_path):
    folder = tmp_path / "in"
    write_photos(folder, 3)
    (folder / "text.jpg").write_text("this is a text file")
    Image.fromarray(picture(9, 200, 200)).save(folder / "half.jpg", quality=95)
    (folder / "half.jpg").write_bytes((folder / "half.jpg").read_bytes()[:2000])
    (folder / "empty.png").write_bytes(b"")
    (folder / "phone.HEIC").write_bytes(b"x")
    (folder / "camera.dng").write_bytes(b"x")
    (folder / "line\nbreak.jpg").write_bytes(b"x")
    (folder / "gone.jpg").symlink_to(tmp_path / "nowhere.jpg")
    notes = Notes()
    photos = load(folder, tmp_path / "out", reporter=notes)
    reasons = {skipped.name: skipped.reason for skipped in photos.skipped}
    assert len(photos.photos) == 3
    assert "not an image" in reasons["text.jpg"]
    assert "cut short" in reasons["half.jpg"]
    assert "empty" in reasons["empty.png"]
    assert "HEIC" in reasons["phone.HEIC"]
    assert "raw" in reasons["camera.dng"]
    assert "rename" in reasons["line\\nbreak.jpg"]
    assert "No such file" in reasons["gone.jpg"]
    assert len(notes.warnings) == 6  # five by name, the rest as a count
    assert "2 more files" in notes.warnings[-1]


def test_test_views_count_readable_photos_only(tmp_path):
    write_photos(tmp_path / "in", 9, first=1)
    (tmp_path / "in/0000.jpg").write_text("words")
    photos = load(tmp_path / "in", tmp_path / "out")
    assert [name for name, test in zip(photos.names, photos.is_test, strict=True) if test] == ["0001.png", "0009.png"]


@pytest.mark.parametrize("count", [1, 2])
def test_fewer_than_three_photos(tmp_path, count):
    write_photos(tmp_path / "in", count)
    (tmp_path / "in/zz.jpg").write_text("words")
    with pytest.raises(DataError, match=rf"fewer than 3 usable photos \({count}\).*zz.jpg \(not an image") as caught:
        load(tmp_path / "in", tmp_path / "out")
    assert "\n" not in caught.value.message
    assert caught.value.hint


def test_no_photos_and_no_folder(tmp_path):
    with pytest.raises(UsageError, match="does not exist"):
        load(tmp_path / "nothing", tmp_path / "out")
    with pytest.raises(DataError, match="no photos"):
        load(tmp_path, tmp_path / "out")
    (tmp_path / "notes.md").write_text("words")
    with pytest.raises(UsageError, match="neither a folder of photos nor a file of poses"):
        load(tmp_path / "notes.md", tmp_path / "out")


def test_what_is_not_a_photo_is_left_out(tmp_path):
    folder = tmp_path / "in"
    names = write_photos(folder, 3)
    for aside in (".hidden", "__MACOSX", "Thumbnails", "@eaDir", "masks"):
        write_photos(folder / aside, 1, first=50)
    write_photos(folder / "cam/left", 1, first=60)
    write_photos(folder / "old_run/eval", 2)
    (folder / "old_run/run.toml").write_text("")
    write_photos(folder / "new_run", 2)
    Image.fromarray(picture()).save(folder / "._0000.png")
    (folder / "Thumbs.db").write_bytes(b"x")
    photos = load(folder, tmp_path / "out", exclude=folder / "new_run")
    assert photos.names == (*names, "cam/left/0060.png")


def test_names_never_leave_the_folder_and_loops_end(tmp_path):
    folder = tmp_path / "in"
    write_photos(folder / "a", 3)
    write_photos(tmp_path / "elsewhere", 1, first=9)
    (folder / "a/again").symlink_to(folder, target_is_directory=True)
    (folder / "linked").symlink_to(tmp_path / "elsewhere", target_is_directory=True)
    names = load(folder, tmp_path / "out").names
    assert names == ("a/0000.png", "a/0001.png", "a/0002.png", "linked/0009.png")


def test_masks_beside_in_and_by_alpha(tmp_path):
    names = write_photos(tmp_path / "images", 4)
    drawn = np.zeros((40, 48), np.uint8)
    drawn[:, 24:] = 255
    for place, name in (("masks", "0000.png"), ("images/masks", "0001.png.png")):
        (tmp_path / place).mkdir(exist_ok=True)
        Image.fromarray(drawn).save(tmp_path / place / name)
    rgba = np.dstack([picture(2), np.full((40, 48), 255, np.uint8)])
    rgba[20:, :, 3] = 0
    Image.fromarray(rgba).save(tmp_path / "images" / names[2])
    Image.fromarray(drawn).save(tmp_path / "masks" / names[2])
    photos = load(tmp_path, tmp_path / "out")
    masks = [photo.mask and cv2.imread(str(tmp_path / "out" / photo.mask), 0) for photo in photos.photos]
    np.testing.assert_array_equal(masks[0], drawn)
    np.testing.assert_array_equal(masks[1], drawn)
    np.testing.assert_array_equal(masks[2] > 0, (drawn > 0) & (np.arange(40) < 20)[:, None])
    assert masks[3] is None


def test_a_photo_with_nothing_left_is_skipped(tmp_path):
    write_photos(tmp_path / "images", 4)
    (tmp_path / "masks").mkdir()
    Image.fromarray(np.zeros((40, 48), np.uint8)).save(tmp_path / "masks/0000.png")
    (tmp_path / "masks/0001.png").write_text("words")
    write_photos(tmp_path / "images", 1, first=4)
    photos = load(tmp_path, tmp_path / "out")
    assert [(s.name, s.reason.split(":")[0]) for s in photos.skipped] == [
        ("0000.png", "every pixel is transparent or masked"),
        ("0001.png", "mask 0001.png"),
    ]


def test_cameras_are_told_apart_by_folder_and_size(tmp_path):
    write_photos(tmp_path / "left", 2)
    write_photos(tmp_path / "right", 2)
    write_photos(tmp_path / "right", 1, first=5, width=64)
    keys = [photo.camera_key for photo in load(tmp_path, tmp_path / "out").photos]
    assert keys[0] == keys[1] != keys[2] == keys[3] != keys[4]


def test_identical_photos_are_kept_and_counted(tmp_path):
    for i in range(4):
        Image.fromarray(picture(i // 3)).save(tmp_path / f"{i}.png")
    notes = Notes()
    photos = load(tmp_path, tmp_path / "out", reporter=notes)
    assert len(photos.photos) == 4
    assert photos.duplicates == (("0.png", "1.png", "2.png"),)
    assert notes.events["photos"]["duplicates"] == 2


def test_scan_reads_headers_only(tmp_path):
    names = write_photos(tmp_path, 3)
    Image.fromarray(picture(9, 300, 200)).save(tmp_path / "half.jpg", quality=95)
    (tmp_path / "half.jpg").write_bytes((tmp_path / "half.jpg").read_bytes()[:2000])
    (tmp_path / "text.jpg").write_text("words")
    seen = scan(tmp_path)
    assert seen.names == (*names, "half.jpg")  # its header is whole
    assert seen.sizes.tolist() == [[48, 40]] * 3 + [[300, 200]]
    assert [skipped.name for skipped in seen.skipped] == ["text.jpg"]


def test_fingerprint_follows_contents(tmp_path):
    write_photos(tmp_path / "images", 3)
    before, quick = fingerprint(tmp_path), fingerprint(tmp_path, quick=True)
    assert before == fingerprint(tmp_path)
    os.utime(tmp_path / "images/0000.png", (1, 1))
    assert fingerprint(tmp_path) == before
    assert fingerprint(tmp_path, quick=True) != quick
    (tmp_path / "images/notes.txt").write_text("not input")
    assert fingerprint(tmp_path) == before
    (tmp_path / "masks").mkdir()
    Image.fromarray(picture()).save(tmp_path / "masks/0000.png")
    masked = fingerprint(tmp_path)
    assert masked != before
    (tmp_path / "images/0000.png").rename(tmp_path / "images/0009.png")
    assert fingerprint(tmp_path) not in (before, masked)


def test_an_output_that_cannot_be_written(tmp_path):
    write_photos(tmp_path / "in", 3)
    (tmp_path / "out").write_text("a file is in the way")
    with pytest.raises(DiskError, match="out"):
        load(tmp_path / "in", tmp_path / "out")


def test_aerial_photos_come_out_upright(tmp_path, shared_data):
    source = tmp_path / "in"
    source.mkdir()
    for path in sorted((shared_data("ochota_aerial") / "images").iterdir())[:3]:
        (source / path.name).symlink_to(path)
    photos = load(source, tmp_path / "out", side=400)
    assert {(photo.width, photo.height, photo.orientation) for photo in photos.photos} == {(300, 400, 6)}
    theirs = cv2.imread(str(source / photos.names[0]))  # OpenCV turns by EXIF
    ours = cv2.imread(str(tmp_path / "out" / photos.photos[0].pixels))
    assert np.abs(cv2.resize(theirs, (300, 400), interpolation=cv2.INTER_AREA).astype(int) - ours).mean() < 2


def test_damaged_exif_is_said(tmp_path, monkeypatch):
    def stumble(self):
        raise struct.error("unpack requires a buffer of 2 bytes")

    write_photos(tmp_path / "in", 3)
    monkeypatch.setattr(Image.Image, "getexif", stumble)
    notes = Notes()
    photos = load_photos(SourcesConfig(), tmp_path / "in", tmp_path / "out", reporter=notes, threads=1)
    assert [photo.exif_readable for photo in photos.photos] == [False] * 3
    assert any("3 photos have damaged EXIF" in warning for warning in notes.warnings)
