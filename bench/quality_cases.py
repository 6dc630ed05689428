"""What the quality benchmark compares. A case is data: settings of the trainer, and changes to its input.

A set is run with every case that fits it. `order` says how soon: what comes first is done for all sets before the next,
and a further seed comes one later, so that a run that is stopped leaves whole tables behind.
"""

from dataclasses import dataclass, field, fields
from typing import Any, Literal

from graphgs.config import Config, with_settings
from graphgs.errors import UsageError

RATES = (0.7, 1.0, 1.4)  # multiples of the default learning rates that the control is tuned over
MEANS_RATES = ("means_rate", "means_rate_final")
OTHER_RATES = ("log_scales_rate", "quats_rate", "logit_opacities_rate", "sh_dc_rate", "sh_rest_rate")

# Where a case runs that names no sets. `drive` is for the nuisances: its photos lie close enough for each to matter.
MAIN = ("fox", "street-own", "street", "castle", "kitti_street", "ochota_aerial")
SYNTHETIC_SETS = ("drive", "street", "street-own")
PLAIN = {"consistency": "none", "sampling": "uniform"}  # together with points="all": what the method adds is off

# What training starts from: the pipeline's points, with dense ones or without ("sparse"); the reconstruction's alone,
# all or 40 % of them; reconstructed and dense ones together, with room for more Gaussians ("joined") or without
# ("filled"), all or 40 % of them.
Points = Literal[
    "pipeline", "sparse", "all", "octree", "random",
    "joined", "joined-octree", "joined-random", "filled", "filled-octree",
]  # fmt: skip


@dataclass(frozen=True)
class Case:
    name: str
    about: str  # for the table
    training: dict[str, Any] = field(default_factory=dict)  # training settings that differ from the preset's
    order: float = 1.0  # of the first seed
    per_seed: float = 1.0  # what each further seed adds to it
    sets: tuple[str, ...] = MAIN  # where it is run
    seeds: int | None = None  # only so many
    steps: float = 1.0  # share of the executed steps

    # Learning rates
    rates: tuple[float, float] = (1.0, 1.0)  # multiples: of the centres', of all others
    tuned: bool = False  # take the rates of the best run of the grid on this set
    time_of: str = ""  # execute as many steps as fit into the seconds of this case

    # Input
    scene: str = ""  # other poses: the prepared scene SET+scene
    points: Points = "pipeline"
    keep_every: int = 1  # train on every n-th training photo
    noise: float = 0.0  # [rad and camera spacings] every pose disturbed by up to this
    disturbed: bool = False  # training poses off by 0.5 degrees and 1 % of the scene
    exposure_stops: float = 0.0  # training photos brighter or darker by up to this
    passers_by: float = 0.0  # share of each training photo covered by something that is in no other

    @property
    def definition(self) -> dict[str, Any]:
        """What a measurement depends on, beside the code: what differs from the defaults."""
        words = ("name", "about", "order", "per_seed", "sets", "seeds")
        values = {f.name: (getattr(self, f.name), f.default) for f in fields(self) if f.name not in words}
        return {name: value for name, (value, default) in values.items() if value not in (default, {})}


def _grid() -> list[Case]:
    return [
        Case(
            f"plain {means:g}/{others:g}", f"plain trainer, rates of centres x {means:g}, others x {others:g}",
            PLAIN, order=0, seeds=1, rates=(means, others), points="all",
        )
        for means in RATES
        for others in RATES
        if (means == 1.0) != (others == 1.0)  # one of the two at a time
    ]  # fmt: skip


CASES = (
    Case(
        "full", "the default: dense points, pruned by the octree, and their depth; consistency; sampling by importance",
        order=0, per_seed=0.2, sets=(*MAIN, "drive"),
    ),
    Case(
        "plain", "control: the same trainer without consistency, sampling, dense points and octree", PLAIN, order=0,
        points="all",
    ),
    *_grid(),
    Case(
        "plain tuned", "control with its learning rates tuned on this set", PLAIN, order=0.5, per_seed=0.2,
        points="all", tuned=True,
    ),
    Case(
        "plain tuned, equal time", "the tuned control for as long as the full method takes", PLAIN,
        order=0.6, per_seed=0.2, points="all", tuned=True, time_of="full",
    ),
    Case(
        "plain, dense points", "the control from the full method's points", PLAIN | {"lambda_depth": 0.0}, order=0.7,
        per_seed=0.2,
    ),
    Case("full, control's rates", "the full method with the tuned control's rates", tuned=True),
    # Consistency
    Case("no consistency", "without the consistency loss (lambda 0)", {"consistency": "none"}),
    Case("lambda .03", "weight of consistency .03", {"lambda_consistency": 0.03}, order=2),
    Case("lambda .15", "weight of consistency .15", {"lambda_consistency": 0.15}, order=2),
    Case("target random", "consistent with a random verified neighbour", {"consistency_target": "random"}),
    Case("target sampled", "target drawn among the best few edges", {"consistency_target": "sampled"}, order=2),
    Case("source truth", "consistent with the other view's photo", {"consistency_source": "truth"}, order=2),
    Case("source both", "with its photo and its render", {"consistency_source": "both"}, order=2),
    Case("consistency paper", "the printed form, without depth", {"consistency": "paper"}, order=2),
    # Sampling
    Case("uniform", "views drawn evenly, equal steps", {"sampling": "uniform"}),
    Case("sampling paper", "the printed rule: draw evenly, skip", {"sampling": "paper"}, order=2),
    Case("sampling affine", "the affine form, drawn independently", {"sampling": "affine"}, order=2),
    Case("sampling loss", "views drawn by their loss", {"sampling": "loss"}, order=2),
    Case("importance degree", "degree in place of betweenness", {"importance": "degree"}, order=2),
    Case("full at .6", "the full method with .6 of the steps", steps=0.6),
    Case("uniform at .6", "even draws with .6 of the steps", {"sampling": "uniform"}, steps=0.6),
    # Initial points
    Case("no dense points", "without dense points and their depths", order=0.8, points="sparse"),
    Case("no depth loss", "without comparing depths with theirs", {"lambda_depth": 0.0}, order=0.9),
    Case("all points", "from all the reconstruction's points, unpruned", points="all"),
    Case("octree .4", "from 40 % of those, pruned by the octree", points="octree"),
    Case("random .4", "from as many of those, drawn at random", points="random"),
    *(
        Case(name, about, {"max_splats": 40_000}, order=1.1, points=points)
        for name, about, points in (
            ("joined", "reconstructed and dense points, unpruned", "joined"),
            ("joined, octree", "40 % of them, pruned by the octree", "joined-octree"),
            ("joined, random", "as many of them, drawn at random", "joined-random"),
        )
    ),
    Case("filled", "as many points as Gaussians are allowed", order=1.1, points="filled"),
    Case("filled, octree", "40 % of them, pruned by the octree", order=1.1, points="filled-octree"),
    # Densification
    Case("mcmc", "densification by sampling (3DGS as MCMC)", {"strategy": "mcmc"}, order=1.4),
    Case("signed gradients", "gradients that may cancel over pixels (3DGS)", {"absgrad": False}, order=1.4),
    Case("kept opacity", "halves of a split keep the opacity (3DGS)", {"revised_opacity": False}, order=1.4),
    # Floaters, sky, passers-by, speed
    Case("sky sphere", "Gaussians on a far sphere from the start", {"sky": "sphere"}, order=1.5),
    Case("robust .1", "up to a tenth of a photo left out", {"robust_share": 0.1}, order=1.5),
    Case("prune near", "without Gaussians close before a camera", {"prune_near": True}, order=1.5),
    Case("prune unconfirmed", "without what one view sees alone", {"prune_unconfirmed": True}, order=1.5),
    Case("warm-up .3", "on smaller photos for .3 of the run", {"warm_up_fraction": 0.3}, order=1.5),
    Case("sparse Adam", "updating what the view saw", {"sparse_adam": True}, order=1.5),
    # Poses
    Case("no filter", "all concentric pairs matched", sets=("fox", "street-own"), scene="unfiltered"),
    Case("no CNNP", "sequential pairs in place of concentric ones", sets=("fox", "street-own"), scene="sequential"),
    Case("paper's pairs", "pairs and filter as printed", sets=("fox", "street-own"), scene="paper"),
    Case("no structure estimation", "coarse poses and points", sets=("fox", "street-own"), scene="coarse"),
    Case("poses disturbed", "poses off by 0.5 degrees and 1 %", sets=("drive", "street", "fox"), disturbed=True),
    Case(
        "poses refined", "the same, refined while training", {"refine_poses": True}, sets=("drive", "street", "fox"),
        disturbed=True,
    ),
    Case("noise 0.3, pipeline", "pairs chosen by such poses", sets=("fox",), scene="noisy-prior"),
    *(
        Case(f"noise {noise:g}", f"every pose off by up to {noise:g} rad and spacings, plain trainer", PLAIN,
             sets=("fox", "street"), points="all", noise=noise)
        for noise in (0.1, 0.2, 0.3)
    ),
    # Exposure
    Case("exposure disturbed", "+-1 stop per photo, no model", sets=("drive", "street"), exposure_stops=1.0),
    Case("exposure model", "+-1 stop per photo, affine model", {"exposure": "affine"}, sets=("drive", "street"),
         exposure_stops=1.0),
    # Passers-by
    Case("passers-by", "something in a twelfth of each photo", order=1.3, sets=("drive", "fox"), passers_by=0.08),
    Case("passers-by, robust", "the same, up to .15 of a photo left out", {"robust_share": 0.15}, order=1.3,
         sets=("drive", "fox"), passers_by=0.08),
    Case("affine exposures", "an exposure model where photos are as they came", {"exposure": "affine"}, order=1.4),
    Case("refined poses", "poses moved where they are our own", {"refine_poses": True}, order=1.4),
    # Sparse views
    *(
        case
        for n in (2, 4)
        for case in (
            Case(f"every {n}. photo", f"full method, every {n}. training photo", order=2, keep_every=n),
            Case(f"every {n}. photo, plain", "the control on them", PLAIN, order=2, points="all", keep_every=n),
        )
    ),
)  # fmt: skip

BY_NAME = {case.name: case for case in CASES}
GRID = tuple(case.name for case in CASES if case.name == "plain" or case.rates != (1.0, 1.0))


def fits(case: Case, set_name: str) -> bool:
    return set_name in case.sets


def unknown_setting(case: Case) -> str | None:
    """Why this version of the trainer does not have a case; None where it does."""
    try:
        with_settings(Config(), [f"training.{name}={value}" for name, value in case.training.items()])
    except UsageError as error:
        return str(error)
    return None


def rated(training: dict[str, Any], rates: tuple[float, float]) -> dict[str, float]:
    """The learning rates among the `training` settings, multiplied."""
    by_name = dict.fromkeys(MEANS_RATES, rates[0]) | dict.fromkeys(OTHER_RATES, rates[1])
    return {name: training[name] * factor for name, factor in by_name.items()}
