"""Settings of the training stage."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class TrainConfig:
    """Defaults are 3DGS (Kerbl et al. 2023, code of the authors) where no other source is named. Every step in here is
    an executed step; `*_fraction` is a share of `steps`, so that a short run goes through the same phases as a long one
    (docs/decisions/0020-training-schedule.md)."""

    steps: int = 30_000
    """Executed optimisation steps, one view each."""
    max_splats: int = 1_000_000
    """Hard limit on the number of Gaussians; never exceeded."""
    ssim_weight: float = 0.2
    """Share of 1 - SSIM in the photometric loss; the rest is L1."""
    sampling: Literal["graphgs", "paper", "affine", "uniform", "loss"] = "graphgs"
    """How views are drawn: in proportion to importance, by skipping (as printed; or with the probabilities of graphgs),
    evenly, or in proportion to how badly they are explained so far."""
    importance: Literal["betweenness", "degree"] = "betweenness"
    """What makes a view of the camera graph important."""

    # Speed of learning
    warm_up_fraction: float = 0.0
    """Share of the run on reduced photos: the first half of it at a quarter of the size, then at half."""
    plateau_steps: int = 0
    """Stop when the mean loss of so many steps is hardly below that of as many before; 0 = never."""
    plateau_gain: float = 0.01
    """What "hardly" means, as a share of the loss."""

    # Learning rates, per step of Adam
    sparse_adam: bool = False
    """Update only what the step's view saw (Taming 3DGS, Mallick et al. 2024); the rest keeps its momentum."""
    means_rate: float = 1.6e-4
    """Centres, in units of the scene extent, at the first step."""
    means_rate_final: float = 1.6e-6
    """Centres at the last step; exponential in between."""
    log_scales_rate: float = 5e-3
    """Log of the standard deviations."""
    quats_rate: float = 1e-3
    """Rotations."""
    logit_opacities_rate: float = 5e-2
    """Opacities before the sigmoid."""
    sh_dc_rate: float = 2.5e-3
    """Constant harmonic."""
    sh_rest_rate: float = 1.25e-4
    """Higher harmonics, above 0: a twentieth of the constant one."""
    short_run_exponent: float = 0.25
    """Ours: runs shorter than 3DGS's 30k steps take all rates but the opacities' times (30k / steps)^this."""
    short_run_means_exponent: float = 0.375
    """The same for the centres, which have farther to go: at 2000 steps 2.8 instead of 2.0 (docs/results.md)."""

    # Colour
    sh_degree: int = 3
    """Highest degree of the spherical harmonics, 0 to 3."""
    sh_degree_interval: int = 1000
    """Steps between two raises of the active degree, at most `sh_degree_fraction` of the run."""
    sh_degree_fraction: float = 0.1
    """Ours: 3DGS reaches degree 3 at a tenth of 30k steps; a short run gets there at 0.3 of its own length."""
    initial_opacity: float = 0.1
    """Opacity of an initial Gaussian."""

    # Where nothing can be seen (docs/decisions/0025-floaters.md)
    near_fraction: float = 0.2
    """Ours: near plane of every render, in depths at which the closest views begin (by the initial points)."""
    prune_near: bool = False
    """Remove Gaussians nearer to a training camera than `near_fraction` of the depth at which its own view begins."""
    prune_unconfirmed: bool = False
    """Remove Gaussians that one view sees alone where its neighbours in the camera graph should see them, too."""

    # Number of Gaussians
    strategy: Literal["adaptive", "mcmc"] = "adaptive"
    """Adaptive control (clone, split, prune) or sampling (3DGS as MCMC, Kheradmand et al. 2024)."""
    densify_from_step: int = 500
    """First step that may clone and split, at most `densify_from_fraction` of the run."""
    densify_from_fraction: float = 0.15
    """Ours, for short runs."""
    densify_until_fraction: float = 0.5
    """Share of the run after which Gaussians are neither added nor reset (15k of 30k)."""
    densify_interval: int = 100
    """Steps between two rounds, at most `densify_interval_fraction` of the run."""
    densify_interval_fraction: float = 0.025
    """Ours: a 1000-step run had 3 rounds; with 14 it ends 2 dB higher on a street that starts from few points."""
    opacity_reg: float | None = None
    """Weight of the mean opacity in the loss; None = 0.01 for mcmc (as there), 0 otherwise."""
    scale_reg: float | None = None
    """Weight of the mean standard deviation, in scene extents; None = 0.01 for mcmc (as there), 0 otherwise."""

    # Adaptive control
    absgrad: bool = True
    """Sum the 2D gradient over pixels by size (AbsGS, Ye et al. 2024), not with its sign as 3DGS does
    (docs/decisions/0024-densification.md)."""
    densify_absgrad: float = 8e-4
    """Its mean, in half image sizes (NDC), above which a Gaussian is cloned or split (gsplat, Ye et al. 2024)."""
    densify_gradient: float = 2e-4
    """The same without `absgrad`."""
    revised_opacity: bool = True
    """Give both halves of a clone or split the opacity 1 - sqrt(1 - o) (Revising Densification, Rota Bulo et al.)."""
    densify_scale: float = 0.01
    """Largest standard deviation, in scene extents, up to which a Gaussian is cloned; a larger one is split."""
    prune_opacity: float = 0.005
    """Gaussians less opaque are removed; with mcmc they move to where others are."""
    prune_scale: float = 0.1
    """Gaussians larger, in scene extents, are removed; from the first opacity reset on."""
    opacity_reset_interval: int = 3000
    """Steps between two resets of the opacities to twice `prune_opacity`; none in runs too short to recover."""

    # MCMC (defaults are the authors')
    mcmc_until_fraction: float = 0.8333
    """Share of the run after which Gaussians neither move nor are added (25k of 30k)."""
    mcmc_growth: float = 0.05
    """Share of Gaussians that a round may add."""
    mcmc_noise: float = 5e5
    """Size of the noise on the centres, times their learning rate."""

    # Consistency between views (METHOD 6)
    consistency: Literal["graphgs", "paper", "none"] = "graphgs"
    """Reprojection by rendered depth, the printed depth-free form, or off."""
    consistency_source: Literal["render", "truth", "both"] = "render"
    """What the other view is: its render (the paper's reading), its photo, or both in turn."""
    consistency_target: Literal["max", "sampled", "random"] = "max"
    """The other view: the edge of largest weight, one of the three largest, or any verified neighbour (a control)."""
    lambda_consistency: float = 0.07
    """Weight of the consistency loss (GraphGS, Cheng et al. 2025)."""
    consistency_from_fraction: float = 0.5
    """Ours: share of the run before it starts; depth is meaningless earlier."""
    consistency_interval: int = 4
    """Ours: every n-th step carries it, as each needs a second render."""

    # Surfaces that photos agree on (docs/decisions/0032-depth-of-surfaces.md)
    lambda_depth: float = 0.05
    """Ours: weight of the difference between rendered depth and surfaces found by plane sweep, at the first step."""

    # Real-world nuisances (docs/decisions/0028-sky-and-passers-by.md)
    sky: Literal["none", "sphere"] = "none"
    """sphere: start with Gaussians on a far sphere, too, wherever a photo looks past all initial points."""
    sky_points: int = 2000
    """On the whole sphere; what is seen of it is kept."""
    robust_share: float = 0.0
    """Largest share of a photo that may be left out of the loss because it fits worst, as passers-by do; 0 = none."""
    robust_from_fraction: float = 0.3
    """Share of the run before anything is left out: at first, everything fits badly."""
    exposure: Literal["none", "affine"] = "none"
    """An affine colour transform per training photo, for cameras that choose their exposure anew for every photo."""
    exposure_rate: float = 0.05
    """Of the transforms, at the first step."""
    exposure_rate_final: float = 0.005
    """At the last step; exponential in between."""
    exposure_weight: float = 0.001
    """Of a transform's squared distance from the identity, in the loss."""
    refine_poses: bool = False
    """Move the poses of training views with the gradient of their images."""
    poses_from_fraction: float = 0.1
    """Share of the run before poses move: the first Gaussians say little about them."""
    pose_reach_deg: float = 1.0
    """Sum of the strides that a pose can turn by in the whole run; each is shorter than the one before."""
    pose_reach: float = 0.05
    """The same for its centre, in units of the scene extent."""

    # Running
    image_cache_bytes: int = 512 * 2**20
    """Decoded training images kept in memory."""
    checkpoint_s: float = 20.0
    """Longest wall time between two checkpoints; does not influence the result."""
