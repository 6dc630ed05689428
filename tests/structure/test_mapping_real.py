"""Real photos with true poses, small enough for every run of the suite."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graphgs.progress import Reporter
from graphgs.scene.similarity import align_robust, diameter
from graphgs.sources import SourcesConfig, load_photos
from graphgs.structure.candidates import candidate_pairs
from graphgs.structure.coarse import coarse_poses
from graphgs.structure.config import StructureConfig
from graphgs.structure.mapping import map_fine
from graphgs.structure.matching import match_pairs
from graphgs.structure.pairing_config import PairingConfig


def true_centers(model_folder):
    """{name: centre} of a COLMAP text model."""
    centers = {}
    for line in (model_folder / "images.txt").read_text().splitlines():
        fields = line.split()
        if len(fields) == 10 and not line.startswith("#"):
            qw, qx, qy, qz, *t = map(float, fields[1:8])
            centers[fields[9]] = -Rotation.from_quat([qx, qy, qz, qw]).as_matrix().T @ t
    return centers


def test_fountain_without_exif_gets_its_poses_and_its_focal_length(shared_data, tmp_path):
    source = shared_data("fountain")
    run = {"reporter": Reporter(), "threads": 2, "seed": 0}
    photos = load_photos(
        SourcesConfig(decode_max_side=768), source / "images", tmp_path / "photos", reporter=Reporter(), threads=2
    )
    config = StructureConfig(fine_features=2048)
    prior = coarse_poses(config, photos, scratch=tmp_path / "coarse", **run)
    assert prior.placed.all()
    pairs = candidate_pairs(PairingConfig(exhaustive_limit=0), prior, reporter=Reporter(), threads=2)
    matches = match_pairs(config, photos, pairs, prior, scratch=tmp_path / "match", **run)
    structure = map_fine(config, photos, matches, prior, scratch=tmp_path / "map", **run)
    assert structure.accepted
    model = structure.reconstruction
    assert model.names == photos.names
    truth = true_centers(source / "gt_colmap")
    target = np.array([truth[name] for name in model.names])
    moved = align_robust(model.centers, target).apply(model.centers)
    assert 100 * np.median(np.linalg.norm(moved - target, axis=1)) / diameter(target) < 0.15
    # K_1536.txt, at half the size
    assert model.cameras[0].params[0] == pytest.approx(1379.74 / 2, rel=0.01)
