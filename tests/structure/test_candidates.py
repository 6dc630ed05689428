"""What pairing is told about each kind of prior, on a street whose true poses and points are known."""

import dataclasses

import numpy as np
import pytest

from graphgs.progress import Reporter
from graphgs.scene.camera import Camera
from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure import candidates
from graphgs.structure.cameras import SharedCameras
from graphgs.structure.candidates import candidate_pairs
from graphgs.structure.pairing_config import PairingConfig
from graphgs.structure.prior import Prior
from graphgs.structure.uncertainty import GPS, PoseUncertainty
from tests.support import camera_tracks as tracks
from tests.support.street_views import street_views

CAMERA = Camera.pinhole(640, 360, 502.3, 502.3, 320, 180)  # 65 degrees, as the street's


@pytest.fixture(scope="module")
def street():
    return street_views(30, width=120, samples=200, threads=2)


@pytest.fixture(scope="module")
def own(street) -> Prior:
    """A coarse reconstruction of the 90 photos, without error, in a world of its own."""
    coarse, n = street.coarse_points(per_camera=60), len(street.centers)
    order = np.lexsort((coarse.visible[:, 0], coarse.visible[:, 1]))
    camera, point = coarse.visible[order].T
    names = tuple(f"{k:04d}.jpg" for k in range(n))
    reconstruction = Reconstruction(
        cameras=(CAMERA,),
        names=names,
        camera_ids=np.zeros(n, np.int64),
        rotations=street.rotations,
        translations=-np.einsum("nab,nb->na", street.rotations, street.centers),
        points=coarse.points,
        track_offsets=np.searchsorted(point, np.arange(len(coarse.points) + 1)),
        track_images=camera.astype(np.int32),
        track_xy=np.zeros((len(camera), 2)),
    )
    return Prior(
        names=names,
        placed=np.ones(n, bool),
        rotations=street.rotations,
        centers=street.centers,
        cameras=SharedCameras((CAMERA,), (True,), np.zeros(n, np.int64)),
        refine=(),
        source="auto",
        reconstruction=reconstruction,
    )


@pytest.fixture
def told(monkeypatch) -> list[dict]:
    """What `make_pairs` was called with."""
    calls = []
    make_pairs = candidates.make_pairs

    def listening(*args, **options):
        calls.append(options)
        return make_pairs(*args, **options)

    monkeypatch.setattr(candidates, "make_pairs", listening)
    return calls


def _pairs(prior: Prior, config: PairingConfig | None = None, **options):
    return candidate_pairs(config or PairingConfig(), prior, reporter=Reporter(), threads=1, **options)


def _moved(own: Prior, source: str, *, angle: float = 0.0, offset: float = 0.0, oriented: bool = True) -> Prior:
    """Poses of another world, 3.7 times as large, with noise of its units."""
    rotations, centers = tracks.moved(own.rotations, own.centers)
    rotations, centers = tracks.noisy(rotations, centers, angle=angle, offset=offset, seed=3)
    if not oriented:
        rotations = np.tile(np.eye(3), (len(centers), 1, 1))
    return dataclasses.replace(own, source=source, rotations=rotations, centers=centers, oriented=oriented)


def test_own_poses_are_sure_and_bring_their_points(own, street, told):
    made = _pairs(own)
    assert made.filter == "frustum"
    assert told[0]["uncertainty"].rotation == pytest.approx(np.radians(1.0))
    np.testing.assert_array_equal(told[0]["points"], own.reconstruction.points)
    share = street.shared(made.pairs).mean(1)
    bare = _pairs(dataclasses.replace(own, reconstruction=None))
    assert bare.filtered < made.filtered
    free = made.kinds & (1 | 4) == 0
    assert (share[free] == 0).mean() < 0.05


def test_poses_from_a_file_are_measured_against_our_own(own, told):
    clean = _pairs(own)
    same = _pairs(_moved(own, "poses"))
    np.testing.assert_array_equal(same.pairs, clean.pairs)
    assert told[1]["uncertainty"].rotation == pytest.approx(np.radians(1.0))
    noisy = _pairs(_moved(own, "poses", angle=0.3, offset=0.3))
    rotation, position = told[2]["uncertainty"]
    assert rotation == pytest.approx(0.1, rel=0.35)
    assert position == pytest.approx(0.3 / np.sqrt(3), rel=0.35)
    assert len(noisy.pairs) > len(clean.pairs)


def test_gps_takes_rotations_from_our_own(own, street, told):
    prior = _moved(own, "gps", offset=1.0, oriented=False)
    made = _pairs(prior)
    assert made.filter == "frustum"
    assert made.filtered > 0
    assert told[0]["uncertainty"] == GPS
    assert told[0]["judged"].all()
    moved, _ = tracks.moved(own.rotations, own.centers)
    np.testing.assert_allclose(told[0]["rotations"], moved, atol=0.1)  # by aligned centres, a metre off each
    share = street.shared(_pairs(prior, PairingConfig(filter="none")).pairs).mean(1)
    kept = {tuple(p) for p in made.pairs.tolist()}
    every = _pairs(prior, PairingConfig(filter="none")).pairs
    overlapping = [tuple(p) for p in every[share >= 0.1].tolist()]
    assert np.mean([p in kept for p in overlapping]) > 0.99


def test_gps_that_our_own_contradicts_judges_nothing(own, told):
    prior = _moved(own, "gps", oriented=False)
    centers = prior.centers.copy()
    centers[[4, 50]] += [40.0, 0.0, 0.0]
    _pairs(dataclasses.replace(prior, centers=centers))
    assert np.flatnonzero(~told[0]["judged"]).tolist() == [4, 50]


def test_photos_our_own_does_not_know_are_not_judged(own, told):
    part = own.reconstruction
    known = np.arange(90) % 9 != 4
    row = np.cumsum(known) - 1
    seen = known[part.track_images]
    point = np.repeat(np.arange(len(part.points)), part.track_lengths)[seen]
    part = dataclasses.replace(
        part,
        names=tuple(np.array(part.names)[known]),
        camera_ids=part.camera_ids[known],
        rotations=part.rotations[known],
        translations=part.translations[known],
        track_images=row[part.track_images[seen]],
        track_offsets=np.searchsorted(point, np.arange(len(part.points) + 1)),
        track_xy=part.track_xy[seen],
    )
    prior = dataclasses.replace(_moved(own, "gps", oriented=False), reconstruction=part)
    made = _pairs(prior)
    np.testing.assert_array_equal(told[0]["judged"], known)
    every = _pairs(prior, PairingConfig(filter="none"))
    kept = {tuple(p) for p in made.pairs.tolist()}
    assert all(tuple(p) in kept for p in every.pairs.tolist() if not known[p].all())
    assert made.filtered > 0


def test_positions_alone_are_not_filtered(own):
    made = _pairs(dataclasses.replace(_moved(own, "gps", oriented=False), reconstruction=None))
    assert made.filter == "none"


def test_the_user_knows_better(own, told):
    _pairs(own, PairingConfig(rotation_sigma_deg=4.0))
    _pairs(own, PairingConfig(position_sigma=0.5))
    _pairs(dataclasses.replace(own, reconstruction=None), PairingConfig(rotation_sigma_deg=4.0))
    assert told[0]["uncertainty"].rotation == told[2]["uncertainty"].rotation == pytest.approx(np.radians(4.0))
    assert told[1]["uncertainty"] == PoseUncertainty(pytest.approx(np.radians(1.0)), 0.5)


@pytest.mark.parametrize("pairs", ["graphgs", "paper", "sequential"])
def test_a_users_pairs_are_added_and_never_filtered(own, pairs):
    unplaced = dataclasses.replace(own, placed=np.arange(90) != 7)
    plain = _pairs(unplaced, PairingConfig(pairs=pairs))
    far = np.array([[0, 89], [7, 80]])
    made = _pairs(unplaced, PairingConfig(pairs=pairs), extra=far)
    before, after = (
        {frozenset((p.names[i], p.names[j])): k for (i, j), k in zip(p.pairs.tolist(), p.kinds.tolist(), strict=True)}
        for p in (plain, made)
    )
    wanted = [frozenset((own.names[i], own.names[j])) for i, j in far]
    assert not set(wanted) & before.keys()
    assert all(after[pair] == 8 for pair in wanted)
    assert after.keys() == before.keys() | set(wanted)
