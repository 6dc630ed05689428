"""Structure estimation on rendered streets with exact truth: pairs, matching, mapping, per selector of pairs.

All times are processor seconds on one thread. What was matched or rendered once is kept in the cache: a run that was
stopped continues, and a selector's cost is the sum over its pairs.
"""

from pathlib import Path

import numpy as np

from bench.metrics import Metric
from bench.streets import CONFIG, Street, cpu_seconds, street
from bench.structure_matches import COARSE, COLMAP, OURS, Timed, mean_cost, timed_matches
from graphgs.progress import Reporter
from graphgs.structure.candidates import candidate_pairs
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.matching import Matches, in_photo_order
from graphgs.structure.model_calls import ModelCalls
from graphgs.structure.pair_set import all_pairs
from graphgs.structure.pairing_config import PairingConfig

SELECTORS = {
    "sequential": PairingConfig(pairs="sequential"),
    "CNNP alone": PairingConfig(pairs="paper", filter="none"),
    "CNNP, paper-strict": PairingConfig(pairs="paper", filter="paper-strict"),
    "CNNP, paper-loose": PairingConfig(pairs="paper", filter="paper-loose"),
    "CNNP, octant": PairingConfig(filter="octant"),
    "graphgs": PairingConfig(),
}
SAMPLE = 300  # pairs of the exhaustive set that are timed


def run(device: str, cache: Path) -> list[Metric]:
    """150 photos by every selector, 600 by the gate against a timed sample of the exhaustive set."""
    return [*selectors(street(cache, 50)), *mapping(street(cache, 50)), *at_scale(street(cache, 200))]


def quick(device: str, cache: Path) -> list[Metric]:
    """The same on 75 photos, without the large set."""
    return [*selectors(street(cache, 25)), *mapping(street(cache, 25)), *at_scale(street(cache, 25))]


def selectors(scene: Street) -> list[Metric]:
    """Pairs, verified pairs, seconds and accuracy of each selector, all with our feature preset."""
    n = len(scene.photos.photos)
    chosen = {name: selected(scene, config) for name, config in SELECTORS.items()}
    sample = np.random.default_rng(0).choice(n * (n - 1) // 2, min(SAMPLE, n * (n - 1) // 2), replace=False)
    sample = all_pairs(n)[np.sort(sample)]
    union = np.unique(np.concatenate([*chosen.values(), sample]), axis=0)
    timed = timed_matches(scene, OURS, union)
    exhaustive = timed.seconds(sample) / len(sample) * n * (n - 1) / 2
    print(f"{n} photos; exhaustive: {n * (n - 1) // 2} pairs, {exhaustive:.0f} s by a sample of {len(sample)}")
    print(
        f"{'selector':20} {'pairs':>7} {'verified':>9} {'match s':>8} {'cheaper':>8} {'map s':>7} {'placed':>7} error"
    )
    metrics = []
    for name, pairs in chosen.items():
        matches, spent = timed.of(pairs), timed.seconds(pairs)
        placed, error, mapped = triangulated(timed, matches, _file(name))
        key = f"structure/{n}/{name}"
        print(
            f"{name:20} {len(pairs):7} {len(matches.edges):9} {spent:8.1f} {exhaustive / spent:7.1f}x {mapped:7.1f} "
            f"{placed:7} {error:.4f} %"
        )
        metrics += [
            Metric(f"{key}/pairs", len(pairs), "", "lower", 0.1),
            Metric(f"{key}/useful", 100 * len(matches.edges) / len(pairs), "%", "higher", 0.1),
            Metric(f"{key}/matching", spent, "s", "lower", 0.5),
            Metric(f"{key}/error", error, "%", "lower", 1.0),
        ]
    return metrics


def mapping(scene: Street) -> list[Metric]:
    """Ours on the gate's pairs against COLMAP's incremental mapper on all pairs. Features of the coarse preset."""
    n = len(scene.photos.photos)
    everything = all_pairs(n)
    timed = timed_matches(scene, COARSE, everything)
    pairs = selected(scene, PairingConfig())
    whole, sparse = timed.of(everything), timed.of(pairs)
    results = {
        "incremental, every pair": incremental(timed, whole, "incremental_all"),
        "incremental, gate": incremental(timed, sparse, "incremental_gate"),
        "triangulated, gate": triangulated(timed, sparse, "triangulated_gate"),
    }
    coarse = scene.coarse_cpu_s
    print(f"{n} photos, mapping; the coarse poses (features, matches, mapping) took {coarse:.1f} s")
    for name, (placed, error, spent) in results.items():
        print(f"{name:26} {spent:8.1f} s {placed:6} placed {error:.4f} %")
    dense, same, ours = (spent for _, _, spent in results.values())
    return [
        Metric(f"structure/{n}/mapping cheaper than exhaustive", dense / ours, "x", "higher", 0.3),
        Metric(f"structure/{n}/mapping cheaper on the same pairs", same / ours, "x", "higher", 0.3),
        Metric(f"structure/{n}/mapping error", results["triangulated, gate"][1], "%", "lower", 1.0),
    ]


def at_scale(scene: Street) -> list[Metric]:
    """The gate's matching against exhaustive matching, both by a timed sample of their pairs."""
    n = len(scene.photos.photos)
    pairs = selected(scene, PairingConfig())
    sample = {"photos": min(n, 120), "sample": SAMPLE}
    every = all_pairs(n)
    exhaustive = len(every) * mean_cost(scene, OURS, every, **sample)
    default = len(every) * mean_cost(scene, COLMAP, every, **sample)
    gate = len(pairs) * mean_cost(scene, OURS, pairs, **sample)
    print(f"{n} photos: {len(pairs)} of {len(every)} pairs; by samples of at most {SAMPLE} pairs among 120 photos:")
    print(f"exhaustive {exhaustive:.0f} s, at COLMAP's features {default:.0f} s; gate {gate:.0f} s")
    return [
        Metric(f"structure/{n}/gate cheaper", exhaustive / gate, "x", "higher", 0.3),
        Metric(f"structure/{n}/gate and features cheaper", default / gate, "x", "higher", 0.3),
        Metric(f"structure/{n}/coarse error", scene.error(scene.prior.reconstruction), "%", "lower", 1.0),
    ]


def selected(scene: Street, config: PairingConfig) -> np.ndarray:
    """[P, 2] i < j of a selector, from the coarse poses."""
    pairs = candidate_pairs(config, scene.prior, reporter=Reporter(), threads=1)
    return np.array(in_photo_order(pairs, scene.photos.names), dtype=np.int64)


def triangulated(timed: Timed, matches: Matches, name: str) -> tuple[int, float, float]:
    """(photos placed, median error in %, CPU s) of triangulation and bundle adjustment from the coarse poses."""
    return _mapped(timed, matches, name, lambda calls: calls.triangulated(timed.street.prior.reconstruction, name))


def incremental(timed: Timed, matches: Matches, name: str) -> tuple[int, float, float]:
    """The same of COLMAP's incremental mapper."""
    return _mapped(timed, matches, name, lambda calls: calls.incremental(name))


def _mapped(timed: Timed, matches: Matches, name: str, make) -> tuple[int, float, float]:
    scene, stored = timed.street, timed.folder / f"{name}.npz"
    if not stored.exists():
        with cpu_seconds() as spent, ColmapWorker(timed.folder) as worker:
            calls = ModelCalls(
                CONFIG, scene.photos, matches, scene.prior, worker, timed.folder, Reporter(), threads=1, seed=0
            )
            model = make(calls)
        placed, error = (0, np.inf) if model is None else (len(model.names), scene.error(model))
        np.savez(stored, placed=placed, error=error, spent=spent[0])
    with np.load(stored) as found:
        return int(found["placed"]), float(found["error"]), float(found["spent"])


def _file(name: str) -> str:
    return name.replace(", ", "_").replace(" ", "_")
