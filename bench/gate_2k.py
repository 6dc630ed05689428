"""The overlap gate on a street of 2000 photos, geometry only: how many pairs it leaves, and how well it tells.

Truth is known for the concentric candidates alone: all pairs would be two million.
"""

from bench.metrics import Metric
from bench.overlap_gate import NOISE, NOISE_SIGMA, OVERLAPPING, Setting
from graphgs.structure import concentric_pairs
from graphgs.structure.pair_set import CONNECTION, NEIGHBOUR
from graphgs.structure.uncertainty import of_reconstruction
from tests.support.street_views import street_views

FRAMES = 667  # of three cameras
MODES = ("paper-strict", "paper-loose", "octant", "frustum")


def run(device: str) -> list[Metric]:
    views = street_views(FRAMES, threads=1)
    coarse = views.coarse_points()
    n, metrics = len(views.centers), []
    sure = of_reconstruction(views.centers)
    noisy = views.with_noise(coarse, angle=NOISE, offset=NOISE, seed=0)
    settings = {
        "clean": Setting(views, views.rotations, views.centers, coarse, sure, None),
        "noisy": Setting(views, *noisy, NOISE_SIGMA, None),
    }
    for prior, setting in settings.items():
        pairs, kinds = concentric_pairs(setting.centers, return_kinds=True)
        protected = kinds & (NEIGHBOUR | CONNECTION) > 0
        share = views.shared(pairs).mean(1)
        overlap, apart = ~protected & (share >= OVERLAPPING), ~protected & (share == 0)
        print(f"{n} images, {prior} prior: {len(pairs)} candidates of {n * (n - 1) // 2} pairs", flush=True)
        for mode in MODES:
            keep = protected | setting.keep(mode, pairs)
            recall, dropped = keep[overlap].mean(), (~keep[apart]).mean()
            useful = (share[keep] >= OVERLAPPING).mean()
            print(f"{mode:14} {keep.sum():7} {useful:6.1%}  {recall:.4f} {dropped:.4f}", flush=True)
            key = f"gate/street 2000/{prior}/{mode}"
            metrics += [
                Metric(f"{key}/pairs", int(keep.sum()), "", "lower", 0.02),
                Metric(f"{key}/recall", float(recall), "", "higher", 0.005),
                Metric(f"{key}/dropped", float(dropped), "", "higher", 0.02),
            ]
    return metrics
