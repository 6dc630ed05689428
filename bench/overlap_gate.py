"""How well each way of choosing pairs tells cameras that share a view from those that do not, on the synthetic street.

The truth comes from the surface: of all surface points that the two cameras see, at least a tenth is seen by both
(overlapping), or none (not). A filter is judged on the concentric candidates it may drop, protected pairs aside.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.metrics import Metric
from graphgs.scene.neighbours import median_spacing
from graphgs.structure import concentric_pairs, filter_pairs, selectors
from graphgs.structure.pair_set import CONNECTION, NEIGHBOUR
from graphgs.structure.uncertainty import PoseUncertainty, of_reconstruction
from tests.support.street_views import CoarsePoints, StreetViews, street_views

FRAMES = {"150": 50, "600": 200}  # images of a rig of three
DRAWS = 3  # of the noise
NOISE = 0.3  # [rad] and [m], largest, uniform
NOISE_SIGMA = PoseUncertainty(NOISE / 3.0, NOISE / np.sqrt(3.0))  # per axis: of the angle, and about a random axis
OVERLAPPING = 0.1
FILTERS = ("paper-strict", "paper-loose", "octant", "frustum")


@dataclass(frozen=True)
class Setting:
    """The street with one prior, and the truth about every pair."""

    views: StreetViews
    rotations: np.ndarray  # the prior's
    centers: np.ndarray
    coarse: CoarsePoints
    uncertainty: PoseUncertainty
    share: np.ndarray  # [N, N] of the points two cameras see, seen by both

    def pairs_by(self) -> dict[str, Callable[[], np.ndarray]]:
        """Every selector by name."""
        n, rotations, centers = len(self.centers), self.rotations, self.centers
        half_angle = np.broadcast_to(np.radians(self.views.fov_deg) / 2, (n, 2))
        depth_range = np.tile([0.5, 20.0], (n, 1)) * median_spacing(centers)
        chosen: dict[str, Callable[[], np.ndarray]] = {
            "exhaustive": lambda: selectors.exhaustive_pairs(n),
            "sequential": lambda: selectors.sequential_pairs(n, window=10),
            "spatial": lambda: selectors.spatial_pairs(centers, 20),
            "frustum boxes": lambda: selectors.frustum_box_pairs(
                rotations, centers, half_angle=half_angle, depth_range=depth_range
            ),
            "concentric": lambda: concentric_pairs(centers),
        }
        return chosen | {f"concentric, {mode}": lambda mode=mode: self.filtered(mode) for mode in FILTERS}

    def candidates(self) -> tuple[np.ndarray, np.ndarray]:
        """(pairs [P, 2], [P] bool: protected)."""
        pairs, kinds = concentric_pairs(self.centers, return_kinds=True)
        return pairs, kinds & (NEIGHBOUR | CONNECTION) > 0

    def filtered(self, mode: str) -> np.ndarray:
        pairs, protected = self.candidates()
        return pairs[protected | self.keep(mode, pairs)]

    def keep(self, mode: str, pairs: np.ndarray) -> np.ndarray:
        known = {"points": self.coarse.points, "visible": self.coarse.visible, "uncertainty": self.uncertainty}
        return filter_pairs(
            pairs, self.rotations, self.centers,
            mode=mode, fov_deg=self.views.fov_deg, **known if mode == "frustum" else {},
        )  # fmt: skip

    def judged(self, mode: str) -> tuple[float, float]:
        """(recall on overlapping candidates, share of the others that is dropped)."""
        pairs, protected = self.candidates()
        pairs = pairs[~protected]
        keep, share = self.keep(mode, pairs), self.share[*pairs.T]
        return float(keep[share >= OVERLAPPING].mean()), float((~keep[share == 0]).mean())


def settings(views: StreetViews) -> dict[str, list[Setting]]:
    """Clean, and noisy in several draws."""
    n = len(views.centers)
    pairs = selectors.exhaustive_pairs(n)
    share = np.eye(n)
    share[pairs[:, 0], pairs[:, 1]] = share[pairs[:, 1], pairs[:, 0]] = views.shared(pairs).mean(1)
    coarse = views.coarse_points()
    draws = [views.with_noise(coarse, angle=NOISE, offset=NOISE, seed=seed) for seed in range(DRAWS)]
    sure = of_reconstruction(views.centers)
    return {
        "clean": [Setting(views, views.rotations, views.centers, coarse, sure, share)],
        "noisy": [Setting(views, *draw, NOISE_SIGMA, share) for draw in draws],
    }


def run(device: str) -> list[Metric]:
    metrics = []
    for size, frames in FRAMES.items():
        for prior, draws in settings(street_views(frames, threads=2)).items():
            print(f"\n{size} images, {prior} prior: pairs, overlapping, without any overlap; recall, dropped")
            for name, chosen in draws[0].pairs_by().items():
                pairs = chosen()
                share = draws[0].share[*pairs.T]
                mode = name.partition(", ")[2]
                line = f"{name:26} {len(pairs):7} {(share >= OVERLAPPING).mean():6.1%} {(share == 0).mean():6.1%}"
                if mode:
                    recall, dropped = np.mean([setting.judged(mode) for setting in draws], axis=0)
                    key = f"pairing/street {size}/{prior}/{mode}"
                    metrics += [
                        Metric(f"{key}/recall", recall, "", "higher", 0.005),
                        Metric(f"{key}/dropped", dropped, "", "higher", 0.02),
                    ]
                    line += f"  {recall:.4f} {dropped:.4f}"
                print(line)
    return metrics
