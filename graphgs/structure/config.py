"""Settings of feature extraction, matching, mapping and undistortion."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class StructureConfig:
    """From photos to camera poses. Defaults were measured on six real photo sets."""

    poses: Literal["keep", "refine", "prior"] = "keep"
    """Poses that come with the input: keep as they are, refine by bundle adjustment, or use to choose pairs only."""

    coarse_max_side: int = 640
    """[px] image size of the quick first reconstruction."""
    coarse_features: int = 1000
    """Largest number of features per image in the first reconstruction."""
    coarse_retry_max_side: int = 1000
    """[px] image size when the first reconstruction places too few photos."""
    coarse_retry_features: int = 3000
    """Features per image when the first reconstruction places too few photos."""
    learned_max_side: int = 800
    """[px] image size for learned features, which come in where the first reconstruction fails."""
    learned_features: int = 1024
    """Largest number of learned features per image; matching costs the square of it."""
    sequence_window: int = 5
    """Neighbours in file order matched in the first reconstruction, on each side; then every power of two."""
    retrieval_words: int = 64
    """Words of the visual vocabulary, trained on the scene itself."""
    retrieval_neighbors: int = 8
    """Most similar photos matched in the first reconstruction, per photo."""

    fine_max_side: int = 1600
    """[px] image size for the features of the final reconstruction."""
    fine_features: int = 4096
    """Largest number of features per image in the final reconstruction; 8192 costs twice the matching."""
    fine_first_octave: int = 0
    """0 starts SIFT at the image's own size; -1 doubles it first: 2.6 times the time, no gain in pose accuracy."""
    chunk_pairs: int = 64
    """Pairs matched between two checkpoints, about the most that a kill can cost."""
    min_inliers: int = 15
    """Verified matches below which a pair does not count (COLMAP's default)."""
    max_error_px: float = 4.0
    """[px] largest reprojection error of a point kept, at the size of the features (COLMAP's default)."""
    min_angle_deg: float = 1.5
    """[deg] smallest triangulation angle of a point kept (COLMAP's default)."""
    bridge_pairs: int = 10
    """Further pairs tried per group of photos that matching left apart, per round."""

    mapper: Literal["ladder", "incremental", "global"] = "ladder"
    """ladder: from the coarse poses, and further steps where the result is not accepted; the rest are COLMAP's own ways
    on the same matches, as baselines."""
    min_registered: float = 0.95
    """Share of the chosen group's photos that must be placed for the result to be accepted."""
    max_apart_share: float = 0.05
    """Share of the usable photos (two always) that may lie in groups without common features with the one that is kept;
    beyond, the result is PARTIAL."""
    max_rotation_median_deg: float = 1.0
    """[deg] largest median change of pairwise rotation between first and final reconstruction."""
    max_rotation_p99_deg: float = 5.0
    """[deg] largest 99th percentile of the same."""
    max_camera_shift: float = 0.025
    """Largest distance a camera may move between first and final reconstruction, as a share of the scene."""

    rig_refinement: Literal["constrained", "free"] = "constrained"
    """Cameras that turn out to be fixed on a rig: constrained gives them one place on it in a last bundle adjustment
    (kept if the photos do not object), free leaves every photo its own pose."""
    rig_baseline_m: float | None = None
    """[m] distance between the first two cameras of a rig (folders by name): makes the result metric."""

    max_side: int | None = None
    """[px] long side of the undistorted training images; None keeps the decoded size."""
