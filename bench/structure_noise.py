"""How much noise on the prior each way of choosing pairs bears: noisy prior, each selector, the same reconstruction.

The prior is the truth with every camera turned by up to so many rad about a random axis and moved by up to so many
metres along each. It chooses pairs, nothing else: COLMAP's incremental mapper starts from nothing on them, so that its
poses tell what the pairs are worth. Each pair is matched once, whoever chose it. Features of the coarse preset.
"""

import json
from pathlib import Path

from bench.metrics import Metric
from bench.streets import Street, street
from bench.structure import incremental
from bench.structure_matches import COARSE, timed_matches
from bench.structure_selectors import POSELESS, selections
from graphgs.structure.pair_set import all_pairs
from graphgs.structure.prior import Prior
from graphgs.structure.priors import poses_prior
from graphgs.workspace import digest
from tests.support.camera_tracks import noisy

FRAMES = (20, 50)  # of three cameras
LEVELS = (0.0, 0.1, 0.2, 0.3)  # [rad] and [m]


def run(device: str, cache: Path) -> list[Metric]:
    return [metric for frames in FRAMES for metric in at_size(street(cache, frames), cache)]


def at_size(scene: Street, cache: Path) -> list[Metric]:
    """One line per selector and level; the rows go into `cache` as well, for `bench.structure_plots`."""
    n = len(scene.photos.photos)
    timed = timed_matches(scene, COARSE, all_pairs(n))
    rows, metrics = [], []
    print(f"{n} photos; noise, selector, pairs, verified, match s, map s, placed, error")
    for level in LEVELS:
        for name, pairs in selections(scene, noisy_prior(scene, level)).items():
            if level > 0 and name in POSELESS:
                continue
            matches, spent = timed.of(pairs), timed.seconds(pairs)
            placed, error, mapped = incremental(timed, matches, f"noise_{digest(pairs.tolist())[:12]}")
            row = {"photos": n, "noise": level, "selector": name, "pairs": len(pairs), "verified": len(matches.edges)}
            rows.append(row | {"matching_s": spent, "mapping_s": mapped, "placed": placed, "error": error})
            print(
                f"{level:4.1f} {name:20} {len(pairs):6} {len(matches.edges):6} {spent:7.1f} {mapped:7.1f} {placed:5} "
                f"{error:.4f} %",
                flush=True,
            )
            key = f"noise/{n}/{level}/{name}"
            metrics += [
                Metric(f"{key}/pairs", len(pairs), "", "lower", 0.1),
                Metric(f"{key}/error", error, "%", "lower", 1.0),
            ]
    (cache / f"noise_{n}.json").write_text(json.dumps(rows, indent=1))
    return metrics


def noisy_prior(scene: Street, level: float) -> Prior:
    """The true poses with noise, as if from a file; our own coarse reconstruction stays beside them."""
    truth = scene.truth
    rotations, centers = noisy(truth.rotations, truth.centers, angle=level, offset=level, seed=0)
    return poses_prior(scene.prior, truth.names, rotations, centers, note=f"truth with noise up to {level}")
