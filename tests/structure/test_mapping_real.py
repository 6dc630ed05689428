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


def true_poses(model_folder):
    """{name: (camera-from-world rotation, centre)} of a COLMAP text model."""
    poses = {}
    for line in (model_folder / "images.txt").read_text().splitlines():
        fields = line.split()
        if len(fields) == 10 and not line.startswith("#"):
            qw, qx, qy, qz, *t = map(float, fields[1:8])
            rotation = Rotation.from_quat([qx, qy, qz, qw]).as_matrix()
            poses[fields[9]] = rotation, -rotation.T @ t
    return poses


def errors(model, truth):
    """(position errors [N] in % of the scene, pairwise rotation errors [P] in degrees)."""
    rotations, centers = (np.array(column) for column in zip(*(truth[name] for name in model.names), strict=True))
    moved = align_robust(model.centers, centers).apply(model.centers)
    positions = 100 * np.linalg.norm(moved - centers, axis=1) / diameter(centers)
    turned = np.einsum("nba,nbc->nac", model.rotations, rotations).reshape(-1, 9)
    i, j = np.triu_indices(len(turned), 1)
    cosine = (np.einsum("pk,pk->p", turned[i], turned[j]) - 1.0) / 2.0
    return positions, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def solved(source, work, *, config, side):
    """The structure of a folder of photos."""
    run = {"reporter": Reporter(), "threads": 2, "seed": 0}
    photos = load_photos(
        SourcesConfig(decode_max_side=side), source / "images", work / "photos", reporter=Reporter(), threads=2
    )
    prior = coarse_poses(config, photos, scratch=work / "coarse", **run)
    pairs = candidate_pairs(PairingConfig(exhaustive_limit=0), prior, reporter=Reporter(), threads=2)
    matches = match_pairs(config, photos, pairs, prior, scratch=work / "match", **run)
    return prior, map_fine(config, photos, matches, prior, scratch=work / "map", **run)


def test_fountain_without_exif_gets_its_poses_and_its_focal_length(shared_data, tmp_path):
    source = shared_data("fountain")
    prior, structure = solved(source, tmp_path, config=StructureConfig(fine_features=2048), side=768)
    assert prior.placed.all()
    assert structure.accepted
    positions, _ = errors(structure.reconstruction, true_poses(source / "gt_colmap"))
    assert np.median(positions) < 0.15
    # K_1536.txt, at half the size
    assert structure.reconstruction.cameras[0].params[0] == pytest.approx(1379.74 / 2, rel=0.01)


def test_a_drive_through_a_bend_tells_its_focal_length(shared_data, tmp_path):
    """It had been called straight, the focal length held at 896 px, the poses bent by 6 degrees and accepted."""
    source = shared_data("kitti_bend")
    _, structure = solved(source, tmp_path, config=StructureConfig(), side=1600)
    assert structure.accepted
    assert structure.cautions == ()
    assert len(structure.reconstruction.names) == 51
    positions, rotations = errors(structure.reconstruction, true_poses(source / "gt_colmap"))
    assert np.median(positions) < 0.15
    assert positions.max() < 1.0
    assert np.percentile(rotations, 99) < 1.0
    assert structure.reconstruction.cameras[0].params[0] == pytest.approx(718.856, rel=0.01)
