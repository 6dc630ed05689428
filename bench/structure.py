"""Structure estimation on rendered streets with exact truth: pairs, matching, mapping, per selector of pairs.

All times are processor seconds on one thread. What was matched or rendered once is kept in the cache: a run that was
stopped continues, and a selector's cost is the sum over its pairs.
"""

import dataclasses
from pathlib import Path

import numpy as np

from bench.metrics import Metric
from bench.streets import CONFIG, Street, cpu_seconds, street
from bench.structure_matches import COARSE, COLMAP, OURS, Timed, mean_cost, timed_matches
from bench.structure_selectors import selected, selections
from graphgs.progress import Reporter
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.matching import Matches, witness_pairs
from graphgs.structure.model_calls import ModelCalls
from graphgs.structure.pair_set import all_pairs
from graphgs.structure.pairing_config import PairingConfig

SAMPLE = 300  # pairs of a set too large to match that are timed
SEEDS = (0, 1, 2)  # of the coarse and the final mapping


def run(device: str, cache: Path) -> list[Metric]:
    """150 photos by every selector, 600 by the gate against a timed sample of the exhaustive set."""
    scene = street(cache, 50)
    metrics = [*mapping(scene), *selectors(scene), *seeds(cache, 50)]
    scene = street(cache, 200)
    return [*metrics, *at_scale(scene), *mapping(scene, dense=False), *seeds(cache, 200)]


def quick(device: str, cache: Path) -> list[Metric]:
    """The same on 75 photos, without the large set."""
    scene = street(cache, 25)
    return [*selectors(scene), *mapping(scene), *at_scale(scene), *seeds(cache, 25)]


def selectors(scene: Street) -> list[Metric]:
    """Pairs, verified pairs, seconds and accuracy of each selector, all with our feature preset."""
    n = len(scene.photos.photos)
    timed = timed_matches(scene, OURS, all_pairs(n))
    exhaustive = timed.seconds(all_pairs(n))
    print(f"{n} photos, all with our feature preset")
    print(
        f"{'selector':20} {'pairs':>7} {'verified':>9} {'match s':>8} {'cheaper':>8} {'map s':>7} {'placed':>7} error"
    )
    metrics = []
    for name, pairs in selections(scene, scene.prior).items():
        matches, spent = timed.of(pairs), timed.seconds(pairs)
        placed, error, mapped = triangulated(timed, matches, _file(name))
        key = f"structure/{n}/{name}"
        print(
            f"{name:20} {len(pairs):7} {len(matches.edges):9} {spent:8.1f} {exhaustive / spent:7.1f}x {mapped:7.1f} "
            f"{placed:7} {error:.4f} %",
            flush=True,
        )
        metrics += [
            Metric(f"{key}/pairs", len(pairs), "", "lower", 0.1),
            Metric(f"{key}/useful", 100 * len(matches.edges) / len(pairs), "%", "higher", 0.1),
            Metric(f"{key}/matching", spent, "s", "lower", 0.5),
            Metric(f"{key}/error", error, "%", "lower", 1.0),
        ]
    return metrics


def seeds(cache: Path, frames: int) -> list[Metric]:
    """The accuracy of ours over seeds of the coarse and the final mapping, which share features and matches."""
    found = []
    for seed in SEEDS:
        scene = street(cache, frames, seed=seed)
        pairs = selected(scene.prior, PairingConfig())
        timed = dataclasses.replace(timed_matches(scene, OURS, pairs), street=scene)
        placed, error, spent = triangulated(timed, timed.of(pairs), f"graphgs_seed_{seed}")
        n = len(scene.photos.photos)
        print(
            f"{n} photos, seed {seed}: {len(pairs)} pairs, {timed.seconds(pairs):.1f} s; "
            f"mapping {spent:.1f} s, {placed} placed, {error:.4f} %",
            flush=True,
        )
        found.append((placed, error))
    placed, errors = zip(*found, strict=True)
    return [
        Metric(f"structure/{n}/seeds/placed at least", min(placed), "", "higher", 0.0),
        Metric(f"structure/{n}/seeds/median error", float(np.median(errors)), "%", "lower", 1.0),
    ]


def mapping(scene: Street, *, dense: bool = True) -> list[Metric]:
    """Ours on the gate's pairs against COLMAP's incremental mapper, on the same pairs and, where `dense`, on all of
    them. Features of the coarse preset."""
    n = len(scene.photos.photos)
    pairs = selected(scene.prior, PairingConfig())
    timed = timed_matches(scene, COARSE, all_pairs(n) if dense else pairs)
    sparse = timed.of(pairs)
    print(f"{n} photos, mapping; the coarse poses (features, matches, mapping) took {scene.coarse_cpu_s:.1f} s")
    ours = _reported("triangulated, gate", triangulated(timed, sparse, "triangulated_gate"))
    same = _reported("incremental, gate", incremental(timed, sparse, "incremental_gate"))
    key = f"structure/{n}/mapping"
    metrics = [
        Metric(f"{key} cheaper on the same pairs", same[2] / ours[2], "x", "higher", 0.3),
        Metric(f"{key} error", ours[1], "%", "lower", 1.0),
    ]
    if dense:
        everything = timed.of(all_pairs(n))
        every = _reported("incremental, every pair", incremental(timed, everything, "incremental_all"))
        metrics.append(Metric(f"{key} cheaper than exhaustive", every[2] / ours[2], "x", "higher", 0.3))
    return metrics


def _reported(name: str, result: tuple[int, float, float]) -> tuple[int, float, float]:
    placed, error, spent = result
    print(f"{name:26} {spent:8.1f} s {placed:6} placed {error:.4f} %", flush=True)
    return result


def at_scale(scene: Street) -> list[Metric]:
    """The gate's matching against exhaustive matching, both by a timed sample of their pairs. A run matches each
    photo's best look-alikes as well: with them the gate costs as much more as there are more pairs."""
    n = len(scene.photos.photos)
    pairs = selected(scene.prior, PairingConfig())
    sample = {"photos": min(n, 120), "sample": SAMPLE}
    every = all_pairs(n)
    exhaustive = len(every) * mean_cost(scene, OURS, every, **sample)
    default = len(every) * mean_cost(scene, COLMAP, every, **sample)
    per_pair = mean_cost(scene, OURS, pairs, **sample)
    more = len(witness_pairs(scene.prior.similar, set(map(tuple, pairs.tolist()))))
    gate, whole = len(pairs) * per_pair, (len(pairs) + more) * per_pair
    print(f"{n} photos: {len(pairs)} of {len(every)} pairs; by samples of at most {SAMPLE} pairs among 120 photos:")
    print(
        f"exhaustive {exhaustive:.0f} s, at COLMAP's features {default:.0f} s; gate {gate:.0f} s; "
        f"with {more} pairs of look-alikes {whole:.0f} s"
    )
    return [
        Metric(f"structure/{n}/gate cheaper", exhaustive / gate, "x", "higher", 0.3),
        Metric(f"structure/{n}/gate and features cheaper", default / gate, "x", "higher", 0.3),
        Metric(f"structure/{n}/gate and look-alikes cheaper", exhaustive / whole, "x", "higher", 0.3),
        Metric(f"structure/{n}/coarse error", scene.error(scene.prior.reconstruction), "%", "lower", 1.0),
    ]


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
                CONFIG, scene.photos, matches, scene.prior, worker, timed.folder, Reporter(), threads=1, seed=scene.seed
            )
            model = make(calls)
        placed, error = (0, np.inf) if model is None else (len(model.names), scene.error(model))
        np.savez(stored, placed=placed, error=error, spent=spent[0])
    with np.load(stored) as found:
        return int(found["placed"]), float(found["error"]), float(found["spent"])


def _file(name: str) -> str:
    return name.replace(", ", "_").replace(" ", "_")
