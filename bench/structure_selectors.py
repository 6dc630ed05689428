"""Every way of choosing pairs that is compared, from one set of coarse poses."""

import subprocess
import sys

import numpy as np

from bench.streets import Street
from bench.structure_matches import COARSE, feature_database
from graphgs.progress import Reporter
from graphgs.scene.neighbours import median_spacing
from graphgs.structure import selectors
from graphgs.structure.candidates import candidate_pairs, fields_of_view
from graphgs.structure.matching import in_photo_order
from graphgs.structure.pair_set import all_pairs
from graphgs.structure.pairing_config import PairingConfig
from graphgs.structure.prior import Prior

CONCENTRIC = {
    "CNNP alone": PairingConfig(pairs="paper", filter="none"),
    "CNNP, paper-strict": PairingConfig(pairs="paper", filter="paper-strict"),
    "CNNP, paper-loose": PairingConfig(pairs="paper", filter="paper-loose"),
    "CNNP, octant": PairingConfig(filter="octant"),
    "graphgs": PairingConfig(),
}
POSELESS = ("exhaustive", "sequential", "vocabulary tree")  # whatever the poses
PARTNERS = 20  # nearest cameras of spatial, look-alikes of the vocabulary tree; COLMAP's defaults are 50 and 100
DEPTH_RANGE = (0.5, 20.0)  # of frustum boxes, in camera spacings: where nothing is known about the scene


def selections(scene: Street, prior: Prior) -> dict[str, np.ndarray]:
    """[P, 2] i < j, sorted, by the selector's name; all photos have a pose in the prior."""
    n, centers = len(prior.names), prior.centers
    boxes = selectors.frustum_box_pairs(
        prior.rotations,
        centers,
        half_angle=np.radians(fields_of_view(prior.cameras)) / 2,
        depth_range=np.tile(DEPTH_RANGE, (n, 1)) * median_spacing(centers),
    )
    return {
        "exhaustive": all_pairs(n),
        "sequential": selected(prior, PairingConfig(pairs="sequential")),
        "vocabulary tree": vocabulary_tree(scene),
        "spatial": selectors.spatial_pairs(centers, PARTNERS),
        "frustum boxes": boxes,
        **{name: selected(prior, config) for name, config in CONCENTRIC.items()},
    }


def selected(prior: Prior, config: PairingConfig) -> np.ndarray:
    """The pairs of the pairing stage."""
    pairs = candidate_pairs(config, prior, reporter=Reporter(), threads=1)
    return np.array(in_photo_order(pairs, prior.names), dtype=np.int64)


def vocabulary_tree(scene: Street) -> np.ndarray:
    """Look-alikes by COLMAP's tree, trained on the scene's own coarse features."""
    database, _ = feature_database(scene, COARSE)
    found = database.with_name("vocabulary_tree.npy")
    if not found.exists():
        command = [sys.executable, "-m", "bench.vocabulary_tree", database, str(PARTNERS), found]
        subprocess.run(command, check=True)
    return np.load(found)
