"""How much noise on the prior each way of choosing pairs bears: noisy prior, each selector, the same reconstruction.

The prior is the truth with every camera turned by up to so many rad about a random axis and moved by up to so many
metres along each. It chooses pairs, nothing else. The final poses come from our own coarse reconstruction of the photos
by triangulation, as in a run; and, for a small set, from nothing by COLMAP's incremental mapper. Each pair is matched
once, whoever chose it. Features of the coarse preset.
"""

import json
from pathlib import Path

from bench.metrics import Metric
from bench.streets import Street, street
from bench.structure import incremental, triangulated
from bench.structure_matches import COARSE, timed_matches
from bench.structure_selectors import POSELESS, selections
from graphgs.structure.pair_set import all_pairs
from graphgs.structure.prior import Prior
from graphgs.structure.priors import poses_prior
from graphgs.workspace import digest
from tests.support.camera_tracks import noisy

FRAMES = (20, 50)  # of three cameras
LEVELS = (0.0, 0.1, 0.2, 0.3)  # [rad] and [m]
FROM_NOTHING = 60  # photos at most: the incremental mapper takes half a minute per selector there


def run(device: str, cache: Path) -> list[Metric]:
    return [metric for frames in FRAMES for metric in at_size(street(cache, frames), cache)]


def at_size(scene: Street, cache: Path) -> list[Metric]:
    """One line per selector and level; the rows go into `cache` as well, for `bench.structure_plots`."""
    n = len(scene.photos.photos)
    timed = timed_matches(scene, COARSE, all_pairs(n))
    rows, metrics = [], []
    print(f"{n} photos; noise, selector, pairs, verified, match s; map s, placed, error; from nothing: the same")
    for level in LEVELS:
        for name, pairs in selections(scene, noisy_prior(scene, level)).items():
            if level > 0 and name in POSELESS:
                continue
            matches, spent = timed.of(pairs), timed.seconds(pairs)
            key = digest(pairs.tolist())[:12]
            results = {"": triangulated(timed, matches, f"noise_triangulated_{key}")}
            if n <= FROM_NOTHING:
                results["from_nothing_"] = incremental(timed, matches, f"noise_{key}")
            row = {"photos": n, "noise": level, "selector": name, "pairs": len(pairs), "verified": len(matches.edges)}
            line = f"{level:4.1f} {name:20} {len(pairs):6} {len(matches.edges):6} {spent:7.1f}"
            for prefix, (placed, error, mapped) in results.items():
                row |= {f"{prefix}mapping_s": mapped, f"{prefix}placed": placed, f"{prefix}error": error}
                line += f" {mapped:7.1f} {placed:5} {error:8.4f} %"
            rows.append(row | {"matching_s": spent})
            print(line, flush=True)
            key = f"noise/{n}/{level}/{name}"
            metrics += [
                Metric(f"{key}/pairs", len(pairs), "", "lower", 0.1),
                Metric(f"{key}/error", results[""][1], "%", "lower", 1.0),
            ]
    (cache / f"noise_{n}.json").write_text(json.dumps(rows, indent=1))
    return metrics


def noisy_prior(scene: Street, level: float) -> Prior:
    """The true poses with noise, as if from a file; our own coarse reconstruction stays beside them."""
    truth = scene.truth
    rotations, centers = noisy(truth.rotations, truth.centers, angle=level, offset=level, seed=0)
    return poses_prior(scene.prior, truth.names, rotations, centers, note=f"truth with noise up to {level}")
