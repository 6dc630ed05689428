"""Pairs of a street matched and timed: the union of all selectors' pairs once, a selector's cost is its share."""

import dataclasses
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.streets import CONFIG, Street
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.database import copy_whole, create_database
from graphgs.structure.features import extract_features
from graphgs.structure.matching import Matches
from graphgs.workspace import digest


@dataclass(frozen=True)
class Preset:
    """Settings of the features."""

    name: str
    features: int
    first_octave: int
    max_side: int = 1600


OURS = Preset("ours", CONFIG.fine_features, CONFIG.fine_first_octave, CONFIG.fine_max_side)
COLMAP = Preset("COLMAP's", 8192, -1, 3200)  # its defaults
COARSE = Preset("coarse", CONFIG.coarse_features, 0, CONFIG.coarse_max_side)


@dataclass(frozen=True)
class Timed:
    """A database of matches, and what each pair cost."""

    street: Street
    folder: Path
    counts: np.ndarray  # [N] features per photo
    cost: dict[tuple[int, int], float]  # [CPU s], matching and verification
    inliers: dict[tuple[int, int], int]  # of the verified pairs

    def of(self, pairs: np.ndarray) -> Matches:
        """The matches of some of the pairs, in a database of their own."""
        database = self.folder / f"{digest(pairs.tolist())[:12]}.db"
        if not database.exists():
            partial = database.with_suffix(".whole")
            copy_whole(self.folder / "database.db", partial)
            with ColmapWorker(self.folder) as worker:
                worker.run("restrict", database=partial, pairs=pairs.tolist())
            partial.rename(database)
        edges = np.array(sorted(p for p in map(tuple, pairs.tolist()) if p in self.inliers), dtype=np.int64)
        inliers = np.array([self.inliers[tuple(edge)] for edge in edges.tolist()])
        return Matches(self.street.photos.names, database, edges, inliers, self.counts, len(pairs))

    def seconds(self, pairs: np.ndarray) -> float:
        return sum(self.cost[tuple(pair)] for pair in pairs.tolist())


def feature_database(street: Street, preset: Preset) -> tuple[Path, np.ndarray]:
    """(database, [N] features per photo) of a preset, made unless it is there. Its folder is for what comes of it."""
    folder = street.folder / f"matches_{preset.features}_{preset.first_octave}_{preset.max_side}"
    folder.mkdir(parents=True, exist_ok=True)
    counts = extract_features(
        street.photos, folder / "features", max_side=preset.max_side, max_features=preset.features,
        first_octave=preset.first_octave, threads=1, progress=lambda done, total: None, cache=street.features,
    )  # fmt: skip
    database = folder / "database.db"
    with ColmapWorker(folder) as worker:
        create_database(worker, database, street.photos, street.prior.cameras, folder / "features")
    return database, counts


def timed_matches(street: Street, preset: Preset, pairs: np.ndarray) -> Timed:
    """The pairs matched with the features of a preset, in a database that keeps what was matched before."""
    database, counts = feature_database(street, preset)
    folder = database.parent
    wanted, times, found = folder / "wanted.npy", folder / "times.npz", folder / "verified.npz"
    np.save(wanted, pairs)
    subprocess.run([sys.executable, "-m", "bench.pair_times", database, wanted, times], check=True)
    with ColmapWorker(folder) as worker:
        worker.run("settle", database=database)
        worker.run("verified", database=database, out=found)
    with np.load(times) as arrays:
        cost = dict(zip(map(tuple, arrays["pairs"].tolist()), arrays["seconds"].tolist(), strict=True))
    with np.load(found) as arrays:
        inliers = dict(zip(map(tuple, arrays["edges"].tolist()), arrays["inliers"].tolist(), strict=True))
    return Timed(street, folder, counts, cost, inliers)


def mean_cost(street: Street, preset: Preset, pairs: np.ndarray, *, photos: int, sample: int) -> float:
    """[CPU s] per pair, of a random sample of the pairs among so many random photos; their features alone are made."""
    rng = np.random.default_rng(0)
    chosen = np.sort(rng.choice(len(street.photos.photos), photos, replace=False))
    inside = pairs[np.isin(pairs, chosen).all(1)]
    inside = inside[np.sort(rng.choice(len(inside), min(sample, len(inside)), replace=False))]
    part = dataclasses.replace(
        street,
        folder=street.folder / f"sample_{digest(chosen.tolist())[:12]}",
        photos=dataclasses.replace(street.photos, photos=tuple(street.photos.photos[k] for k in chosen), rigs=()),
        prior=dataclasses.replace(
            street.prior,
            cameras=dataclasses.replace(street.prior.cameras, camera_ids=street.prior.cameras.camera_ids[chosen]),
        ),
    )
    timed = timed_matches(part, preset, np.searchsorted(chosen, inside))
    return timed.seconds(np.searchsorted(chosen, inside)) / len(inside)
