"""The synthetic street: photos, poses, depths and points that agree with each other, and the same bytes every time."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from graphgs.errors import DiskError
from graphgs.scene.colmap import read_model
from graphgs.synth import StreetConfig, write_street

SMALL = StreetConfig(frames=4, width=160, height=90, texels_per_m=16.0, points=400)


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    return write_street(SMALL, tmp_path_factory.mktemp("street"), threads=2)


def _read(street, name: str) -> np.ndarray:
    return np.asarray(Image.open(street.images / name)).astype(float)


def _digest(folder) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_points_project_where_the_depth_images_say(street):
    truth = street.reconstruction
    camera = truth.cameras[0]
    point_of = np.repeat(np.arange(len(truth.points)), truth.track_lengths)
    assert len(truth.points) > 200
    errors = []
    for i, name in enumerate(truth.names):
        mine = truth.track_images == i
        local = truth.points[point_of[mine]] @ truth.rotations[i].T + truth.translations[i]
        xy = local[:, :2] / local[:, 2:] * camera.focal_and_center[0] + [camera.width / 2, camera.height / 2]
        np.testing.assert_allclose(xy, truth.track_xy[mine], atol=1e-6)
        cols, rows = np.floor(xy).astype(int).T
        errors.append(np.abs(street.depth(name)[rows, cols] / local[:, 2] - 1))
    # A pixel centre is up to 0.7 px from the point: slanted ground changes depth by that much, not by more.
    assert np.median(np.concatenate(errors)) < 2e-3
    assert np.concatenate(errors).max() <= 0.01


def test_photos_agree_at_the_same_surface_point(street):
    """Colours of a point in the photos that see it agree far better than those of neighbouring points do."""
    truth = street.reconstruction
    seen = np.stack(
        [
            _read(street, truth.names[i])[int(y), int(x)]
            for i, (x, y) in zip(truth.track_images, truth.track_xy, strict=True)
        ]
    )
    spread = [
        np.ptp(seen[a:b], axis=0).mean() for a, b in zip(truth.track_offsets, truth.track_offsets[1:], strict=False)
    ]
    shuffled = np.abs(np.diff(np.random.default_rng(0).permutation(seen), axis=0)).mean(1)
    assert np.median(spread) < 0.35 * np.median(shuffled)


def test_the_drive_moves_forward_and_turns(street):
    truth = street.reconstruction
    forward = truth.rotations[:, 2]
    step = np.diff(truth.centers, axis=0)
    assert ((step * forward[:-1]).sum(1) > 0.5 * SMALL.spacing).all()
    assert np.degrees(np.arccos(np.clip(forward[0] @ forward[-1], -1, 1))) > 1.0


def test_truth_reads_back_as_a_colmap_model(street):
    model = read_model(street.truth)
    assert model.names == street.reconstruction.names == tuple(f"{k:06d}.jpg" for k in range(1, 5))
    np.testing.assert_allclose(model.centers, street.reconstruction.centers, atol=1e-9)
    np.testing.assert_array_equal(model.track_lengths, street.reconstruction.track_lengths)
    assert model.cameras[0].params == street.reconstruction.cameras[0].params


def test_same_bytes_for_any_number_of_threads_and_other_bytes_for_another_seed(street, tmp_path):
    write_street(SMALL, tmp_path / "again", threads=1)
    assert _digest(tmp_path / "again") == _digest(street.images.parent)
    other = write_street(replace(SMALL, seed=1, frames=1), tmp_path / "other")
    assert np.abs(_read(other, "000001.jpg") - _read(street, "000001.jpg")).mean() > 10


def test_exif_carries_the_focal_length_only_when_asked(street, tmp_path):
    focal = Image.open(street.images / "000001.jpg").getexif().get_ifd(0x8769)[0xA405]
    assert focal == 30  # 65 degrees over a 16:9 picture: 28.2 mm by its width, 29.6 by its diagonal
    bare = write_street(replace(SMALL, frames=1, exif=False, depth=False), tmp_path)
    assert not Image.open(bare.images / "000001.jpg").getexif()
    assert not (bare.truth / "depth").exists()


def test_three_cameras_look_apart(tmp_path):
    rig = write_street(replace(SMALL, frames=2, cameras=3), tmp_path).reconstruction
    assert rig.names == tuple(f"{side}/{k:06d}.jpg" for side in ("front", "left", "right") for k in (1, 2))
    front, left, right = rig.rotations[[0, 2, 4], 2]  # viewing directions in the first frame
    side = rig.rotations[0, 0]  # to the right of the front camera
    assert left @ side < -0.5 < 0.5 < right @ side
    assert np.degrees(np.arccos(front @ left)) == pytest.approx(45, abs=1e-6)
    assert len(rig.cameras) == 3


def test_exposure_changes_brightness_as_recorded(street, tmp_path):
    varied = write_street(replace(SMALL, exposure_stops=0.5), tmp_path)
    stops = json.loads((varied.truth / "exposures.json").read_text())["stops"]
    assert len(set(stops.values())) == 4
    assert max(map(abs, stops.values())) <= 0.5
    for name, stop in stops.items():
        plain, exposed = _read(street, name), _read(varied, name)
        unclipped = (plain > 20) & (plain < 160)
        assert np.median(exposed[unclipped] / plain[unclipped]) == pytest.approx(2 ** (stop / 2.2), rel=0.02)


def test_noise_is_as_strong_in_grey_as_asked_for(street, tmp_path):
    noisy = write_street(replace(SMALL, noise=6.0, depth=False), tmp_path)
    plain, found = _read(street, "000001.jpg").mean(-1), _read(noisy, "000001.jpg").mean(-1)
    unclipped = (plain > 30) & (plain < 225)
    assert np.std((found - plain)[unclipped]) == pytest.approx(6.0, rel=0.15)


@pytest.mark.parametrize(
    "wrong",
    [
        {"frames": 0}, {"cameras": 2}, {"fov_deg": 180.0}, {"exposure_stops": -1.0}, {"course": "circle"},
        {"sway": -0.1}, {"noise": -1.0},
    ],
)  # fmt: skip
def test_wrong_settings_are_named(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        StreetConfig(**wrong)


def test_unwritable_folder_is_one_clear_error(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(DiskError, match="cannot write"):
        write_street(replace(SMALL, frames=1), tmp_path / "file")
