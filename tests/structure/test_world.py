"""The final frame: metres and compass directions from GPS, metres from a rig's baseline."""

import dataclasses
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.config import StructureConfig
from graphgs.structure.prior import Prior
from graphgs.structure.priors import make_prior
from graphgs.structure.rigs import RigPose
from graphgs.structure.world import fit_gps, from_plain, plain, settled
from tests.structure.test_coarse_parts import empty_prior, photos_of

N = 40
SPIN = Rotation.from_rotvec([0.4, -1.2, 2.0]).as_matrix()  # of the arbitrary world, from east, north, up
SCALE, SHIFT = 0.07, np.array([3.0, -1.0, 2.0])


def level_cameras(n: int, seed: int = 0) -> np.ndarray:
    """[n, 3, 3] cam_from_enu of cameras held about level, looking anywhere: y down is -z of the world."""
    rng = np.random.default_rng(seed)
    heading = rng.uniform(0, 2 * np.pi, n)
    right = np.stack([np.cos(heading), np.sin(heading), np.zeros(n)], axis=1)
    down = np.tile([0.0, 0.0, -1.0], (n, 1))
    level = np.stack([right, down, np.cross(right, down)], axis=1)
    return Rotation.from_rotvec(rng.normal(0, 0.05, (n, 3))).as_matrix() @ level


def in_another_world(enu: np.ndarray, cameras: np.ndarray) -> Reconstruction:
    centers, rotations = SCALE * enu @ SPIN.T + SHIFT, cameras @ SPIN.T
    n = len(enu)
    return Reconstruction(
        (Camera.pinhole(64, 48, 60, 60, 32, 24),),
        tuple(f"{k:03d}.jpg" for k in range(n)),
        np.zeros(n, int),
        rotations,
        -np.einsum("nij,nj->ni", rotations, centers),
        points=centers + rotations[:, 2],
    )


def tracks(kind: str, n: int = N) -> np.ndarray:
    """[n, 3] m"""
    t = np.linspace(-1, 1, n)
    if kind == "straight":
        return np.stack([60 * t, 80 * t, 0 * t], axis=1)
    if kind == "bent":
        return np.stack([100 * t, 40 * t**2, 2 * np.sin(3 * t)], axis=1)
    grid = np.stack(np.meshgrid(np.arange(8.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    return np.c_[20 * grid, 100 + 5 * np.sin(np.arange(len(grid)))]


@pytest.mark.parametrize("kind", ["straight", "bent", "survey"])
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_cameras_come_to_their_positions(kind, noise):
    rng = np.random.default_rng(1)
    enu = tracks(kind)
    model = in_another_world(enu, level_cameras(N))
    gps = enu + noise * rng.normal(size=enu.shape) * [1, 1, 2]
    gps[[3, 17, 30]] += [[400, 0, 0], [0, -90, 300], [-5000, 5000, 0]]  # lost fixes
    fit = fit_gps(model.centers, -model.rotations[:, 1], gps)
    assert np.flatnonzero(~fit.agrees).tolist() == [3, 17, 30]
    error = np.linalg.norm(fit.enu_from_world.apply(model.centers) - enu, axis=1)
    assert error.max() < 1e-3 + 1.5 * noise  # the mean of 37 positions, and a turn by their error over the track
    assert fit.enu_from_world.scale == pytest.approx(1 / SCALE, rel=1e-5 + 0.01 * noise)
    up = model.rotations[:, 1] @ -fit.enu_from_world.rotation.T
    tilt = np.degrees(np.arccos(up.mean(0)[2] / np.linalg.norm(up.mean(0))))
    # A straight track leaves the roll to the photos' mean "up", which 0.05 rad of 40 cameras moves by half a degree.
    assert tilt < 1.5 + noise


def test_cameras_that_are_not_level_say_nothing_about_up():
    enu = tracks("survey")
    model = in_another_world(enu, Rotation.random(N, random_state=2).as_matrix())
    fit = fit_gps(model.centers, -model.rotations[:, 1], enu)
    np.testing.assert_allclose(fit.enu_from_world.apply(model.centers), enu, atol=1e-3)


def prior_of(model: Reconstruction, gps: np.ndarray) -> Prior:
    prior = empty_prior(photos_of(None, len(gps)))
    return dataclasses.replace(
        prior, names=model.names, placed=np.isfinite(gps[:, 0]), centers=gps, source="gps", origin=(55.0, 13.0, 40.0)
    )


def rig_of(baseline: float, *, rigid: bool = True) -> RigPose:
    places = np.array([[0, 0, 0], [-baseline, 0, 0]])
    zeros = np.zeros(2)
    return RigPose(("left", "right"), np.tile(np.eye(3), (2, 1, 1)), places, zeros.astype(int), zeros, zeros, rigid)


def test_the_world_becomes_metric_and_says_how_well_it_fits():
    enu = tracks("bent")
    model = in_another_world(enu, level_cameras(N))
    gps = enu + np.random.default_rng(0).normal(0, 2.0, enu.shape)
    gps[5] = np.nan  # a photo without
    gps[9] += 300
    turned, rigs, frame, trouble = settled(model, prior_of(model, gps), (rig_of(0.5 * SCALE),), baseline_m=None)
    assert trouble == ""
    assert (frame.scale_from, frame.compass, frame.origin, frame.rejected) == (
        "gps",
        True,
        (55.0, 13.0, 40.0),
        ("009.jpg",),
    )
    assert frame.used == N - 2
    assert rigs[0].baselines[1] == pytest.approx(0.5, rel=0.03)
    # the median length of a normal vector is 1.54 deviations
    assert 1.2 * 2 < frame.median_m < 1.9 * 2
    assert frame.worst == "009.jpg"
    assert frame.worst_m == pytest.approx(300 * np.sqrt(3), rel=0.05)
    assert frame.horizontal_median_m < frame.median_m
    # 2 m over a track with a root sum of squares of some 390 m
    assert 0.002 < frame.scale_deviation < 0.01
    np.testing.assert_allclose(turned.points - turned.centers, turned.rotations[:, 2] / SCALE, rtol=0.03, atol=0.3)
    assert from_plain(json.loads(json.dumps(plain(frame)))) == frame
    assert "metres, x east, y north, z up" in frame.describe()
    assert "(009.jpg); 1 positions far off" in frame.describe()


def test_a_known_baseline_is_believed_before_gps():
    enu = tracks("bent")
    model = in_another_world(enu, level_cameras(N))
    gps = 1.2 * enu  # a bad map
    rig = rig_of(0.5 * SCALE)
    turned, rigs, frame, _ = settled(model, prior_of(model, gps), (rig,), baseline_m=0.5)
    assert (frame.scale_from, frame.compass) == ("rig", True)
    assert rigs[0].baselines[1] == pytest.approx(0.5)
    length = np.linalg.norm(turned.centers[-1] - turned.centers[0])
    assert length == pytest.approx(np.linalg.norm(enu[-1] - enu[0]))


def test_without_anything_to_go_by_the_world_stays():
    model = in_another_world(tracks("bent"), level_cameras(N))
    nothing = empty_prior(photos_of(None, 3))
    same, _, frame, trouble = settled(model, nothing, (), baseline_m=None)
    assert (same, frame, trouble) == (model, None, "")
    for rigs, reason in (((), "show no rig"), ((rig_of(1.0, rigid=False),), "do not keep their distance")):
        same, _, frame, trouble = settled(model, nothing, rigs, baseline_m=0.5)
        assert (same, frame) == (model, None)
        assert reason in trouble
    for gps in (np.full((N, 3), np.nan), np.zeros((N, 3))):
        same, _, frame, trouble = settled(model, prior_of(model, gps), (), baseline_m=None)
        assert (same, frame) == (model, None)
        assert "cannot orient the scene" in trouble


def test_positions_from_a_file_are_a_prior(tmp_path, monkeypatch):
    photos = photos_of(tmp_path, 4)
    monkeypatch.setattr("graphgs.structure.priors.own_prior", lambda config, photos, **run: empty_prior(photos))
    (tmp_path / "gps.csv").write_text("name,lat,lon\n" + "".join(f"{k:02d}.jpg,50,{8 + 1e-4 * k}\n" for k in range(3)))
    run = {"scratch": tmp_path, "reporter": Reporter(), "threads": 1, "seed": 0}
    prior = make_prior(StructureConfig(), photos, wanted=f"gps={tmp_path / 'gps.csv'}", **run)
    assert prior.source == "gps"
    assert prior.placed.tolist() == [True, True, True, False]
    assert np.ptp(prior.centers[:3, 0]) == pytest.approx(14.34, abs=0.01)  # two steps of 7.17 m at 50 degrees north
    prior.save(tmp_path / "prior")
    assert Prior.load(tmp_path / "prior").origin == prior.origin
