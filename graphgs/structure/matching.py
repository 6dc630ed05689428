"""Features at full quality, matched and geometrically verified for the chosen pairs only."""

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.errors import DataError
from graphgs.progress import Reporter
from graphgs.sources.photos import Photos
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.components import components, describe
from graphgs.structure.config import StructureConfig
from graphgs.structure.crashes import Crash, match_around_crashes
from graphgs.structure.database import create_database, link_or_copy
from graphgs.structure.feature_cache import FeatureCache
from graphgs.structure.features import crashed_photos, extract_features
from graphgs.structure.gps import nearest_by_gps
from graphgs.structure.nothing_matches import fault_of_photos
from graphgs.structure.pairing import Pairs
from graphgs.structure.prior import Prior

_BRIDGE_ROUNDS = 2
_GPS_NEIGHBORS = 10  # of a photo that look-alikes do not tie to the others
_WITNESSES = 3  # look-alikes per photo: 0 to 3 pairs more on four real sets, 7 to 17 % on rendered streets


@dataclass(frozen=True)
class Matches:
    """The verified pairs, and the database with their matches."""

    names: tuple[str, ...]  # [N] all photos
    database: Path  # COLMAP database; image i has the id i + 1
    edges: np.ndarray  # [E, 2] int, i < j, sorted
    inliers: np.ndarray  # [E] verified matches
    features: np.ndarray  # [N] features per photo
    candidates: int  # pairs tried, bridges and witnesses included
    basis: str = ""  # hash of all that the matches of a pair depend on; equal ones may share them
    crashes: tuple[Crash, ...] = ()  # photos and pairs that could not be matched, as they end COLMAP's process

    @property
    def component(self) -> np.ndarray:
        """Image indices of the largest connected group."""
        return components(len(self.names), self.edges)[0]

    def save(self, folder: Path) -> None:
        """The database goes into the folder (a hard link where possible)."""
        folder.mkdir(parents=True, exist_ok=True)
        target = folder / "database.db"
        if not (target.exists() and os.path.samefile(target, self.database)):
            target.unlink(missing_ok=True)
            link_or_copy(self.database, target)
        np.savez(folder / "matches.npz", edges=self.edges, inliers=self.inliers, features=self.features)
        header = {"names": list(self.names), "candidates": self.candidates, "basis": self.basis}
        header["crashes"] = [[list(crash.photos), crash.by] for crash in self.crashes]
        (folder / "matches.json").write_text(json.dumps(header, indent=1))

    @staticmethod
    def load(folder: Path) -> "Matches":
        header = json.loads((folder / "matches.json").read_text())
        with np.load(folder / "matches.npz", allow_pickle=False) as arrays:
            names = tuple(header.pop("names"))
            header["crashes"] = tuple(Crash(tuple(photos), by) for photos, by in header.get("crashes", ()))
            return Matches(names, folder / "database.db", **header, **dict(arrays))


def match_pairs(
    config: StructureConfig,
    photos: Photos,
    pairs: Pairs,
    prior: Prior,
    *,
    scratch: Path,
    reporter: Reporter,
    threads: int,
    seed: int,
    cache: FeatureCache | None = None,
    earlier: Path | None = None,  # folder of Matches, whole or missing; pairs matched there are not matched again
) -> Matches:
    """Match the candidates; photos left apart get further pairs with their look-alikes. A killed run continues from the
    database in `scratch`. Raises DataError when no three photos hang together."""
    scratch.mkdir(parents=True, exist_ok=True)
    database = scratch / "database.db"
    n = len(photos.photos)
    tried = in_photo_order(pairs, photos.names)
    features = extract_features(
        photos,
        scratch / "features",
        max_side=config.fine_max_side,
        max_features=config.fine_features,
        first_octave=config.fine_first_octave,
        threads=threads,
        progress=lambda done, total: reporter.progress(done, total, "features"),
        cache=cache,
    )
    lost = crashed_photos(photos, scratch / "features")
    basis = _basis(config, photos, prior, scratch / "features", seed)
    with ColmapWorker(scratch) as worker:
        if earlier is not None and not database.exists():
            _carry_over(worker, earlier, basis, tried, database, reporter)
        create_database(worker, database, photos, prior.cameras, scratch / "features")

        def verify(chosen: list[tuple[int, int]], note: str) -> tuple[np.ndarray, np.ndarray, tuple[Crash, ...]]:
            return match_and_verify(
                worker,
                database,
                photos.names,
                chosen,
                config,
                progress=lambda done, total: reporter.progress(done, total, note),
                threads=threads,
                seed=seed,
            )

        edges, inliers, crashes = verify(tried, "matching")
        beside = _in_turn(prior.similar, nearest_by_gps(photos, _GPS_NEIGHBORS))
        for _ in range(_BRIDGE_ROUNDS):
            bridges = bridge_candidates(n, edges, beside, set(tried), per_group=config.bridge_pairs)
            if not bridges:
                break
            tried += bridges
            edges, inliers, crashes = verify(tried, "bridges")
        witnesses = witness_pairs(prior.similar, set(tried))
        if witnesses:
            tried += witnesses
            edges, inliers, crashes = verify(tried, "witnesses")
        worker.run("settle", database=database)
        reporter.event("worker", stage="matching", peak_rss_mb=round(worker.peak_rss_mb))
    groups = components(n, edges)
    reporter.event(
        "matches",
        candidates=len(tried),
        exhaustive=n * (n - 1) // 2,
        verified=len(edges),
        groups=[len(group) for group in groups[:10]],
    )
    if len(groups[0]) < 3:
        fault = fault_of_photos(photos, features, threads=threads)
        raise fault or _apart(photos.names, groups, len(tried), len(edges))
    if len(groups) > 1:
        reporter.warn(
            f"the photos fall into {len(groups)} groups without common features, of which one can be kept: "
            f"{describe(photos.names, groups)}"
        )
    return Matches(photos.names, database, edges, inliers, features, len(tried), basis, lost + crashes)


def match_and_verify(
    worker: ColmapWorker,
    database: Path,
    names: tuple[str, ...],  # [N] all photos
    pairs: list[tuple[int, int]],  # image indices i < j
    config: StructureConfig,
    *,
    progress: Callable[[int, int], None],
    threads: int,
    seed: int,
) -> tuple[np.ndarray, np.ndarray, tuple[Crash, ...]]:
    """(edges [E, 2], inliers [E], crashes) of all verified pairs in the database, after these have been matched too. It
    is worked on in chunks: a kill loses one of them at most. Pairs that end the worker every time are passed over."""
    crashes = match_around_crashes(
        worker,
        names,
        pairs,
        database.with_name("crashes.json"),
        progress=progress,
        database=database,
        chunk_pairs=config.chunk_pairs,
        matching={},
        verification=_verification(config, seed),
        threads=threads,
        scratch=database.parent,
    )
    found = database.parent / "verified.npz"
    worker.run("verified", database=database, out=found)
    with np.load(found, allow_pickle=False) as arrays:
        return arrays["edges"], arrays["inliers"], crashes


def _verification(config: StructureConfig, seed: int) -> dict:
    return {"min_num_inliers": config.min_inliers, "ransac": {"random_seed": seed}}


def _basis(config: StructureConfig, photos: Photos, prior: Prior, features: Path, seed: int) -> str:
    """What one pair's matches are made from: features, intrinsics (verification is calibrated), limits."""
    content = hashlib.sha256(json.dumps([prior.cameras.records(), prior.cameras.camera_ids.tolist()]).encode())
    content.update(json.dumps(_verification(config, seed), sort_keys=True).encode())
    for photo in photos.photos:
        content.update((features / f"{photo.pixels}.npz").read_bytes())
    return content.hexdigest()


def _carry_over(
    worker: ColmapWorker,
    earlier: Path,
    basis: str,
    pairs: list[tuple[int, int]],
    database: Path,
    reporter: Reporter,
) -> None:
    """Start from an earlier database if its pairs were matched alike, without those that are no longer wanted."""
    try:
        if json.loads((earlier / "matches.json").read_text()).get("basis") != basis:
            return
    except FileNotFoundError:
        return
    partial = database.with_suffix(".earlier")
    shutil.copyfile(earlier / "database.db", partial)
    kept = worker.run("restrict", database=partial, pairs=pairs)["kept"]
    partial.rename(database)
    reporter.info(f"{kept} of {len(pairs)} pairs are matched already")


def in_photo_order(pairs: Pairs, names: tuple[str, ...]) -> list[tuple[int, int]]:
    """The candidates as sorted indices into the photos (pairing counts the placed photos first)."""
    index = {name: k for k, name in enumerate(names)}
    row = np.array([index[name] for name in pairs.names], dtype=np.int64)
    return sorted((int(min(p)), int(max(p))) for p in row[pairs.pairs])


def bridge_candidates(
    n: int,
    edges: np.ndarray,  # [E, 2] verified
    similar: np.ndarray,  # [N, k] photos that may show the same, best first
    tried: set[tuple[int, int]],
    *,
    per_group: int,
) -> list[tuple[int, int]]:
    """For each group but the largest, its best untried pairs with the rest; by file order if none are known."""
    groups = components(n, edges)
    chosen: set[tuple[int, int]] = set()
    for group in groups[1:]:
        inside = np.zeros(n, dtype=bool)
        inside[group] = True
        ranked = []
        for i in group:
            order = similar[i] if similar.size else sorted(np.flatnonzero(~inside), key=lambda j: (abs(j - i), j))
            outside = [int(j) for j in order if j >= 0 and not inside[j]]
            ranked += [(rank, min(int(i), j), max(int(i), j)) for rank, j in enumerate(outside)]
        fresh = [(i, j) for _, i, j in sorted(ranked) if (i, j) not in tried and (i, j) not in chosen]
        chosen.update(fresh[:per_group])
    return sorted(chosen)


def _in_turn(
    alike: np.ndarray,  # [N, k], or empty
    near: np.ndarray,  # [N, l]
) -> np.ndarray:
    """[N, k + l] the columns of two lists of photos by turns; -1 where there is none. Empty if neither knows any."""
    if not alike.size:
        return near if (near >= 0).any() else alike
    tables = [(table, k) for k in range(max(alike.shape[1], near.shape[1])) for table in (alike, near)]
    return np.stack([table[:, k] for table, k in tables if k < table.shape[1]], axis=1)


def witness_pairs(
    similar: np.ndarray,  # [N, k] look-alikes, best first
    tried: set[tuple[int, int]],
) -> list[tuple[int, int]]:
    """Each photo's best look-alikes that the poses gave no reason to match. Where poses fold, these are the photos
    that truly stand side by side, and their matches will contradict the model; where they are sound, there are hardly
    any."""
    rows, ranks = np.nonzero(similar[:, :_WITNESSES] >= 0)
    pairs = {(min(i, j), max(i, j)) for i, j in zip(rows.tolist(), similar[rows, ranks].tolist(), strict=True)}
    return sorted(pairs - tried)


def _apart(names: tuple[str, ...], groups: list[np.ndarray], candidates: int, verified: int) -> DataError:
    return DataError(
        f"the photos do not show one connected scene: of {candidates} candidate pairs {verified} share features, and "
        f"the largest group holds {len(groups[0])} of {len(names)} photos: {describe(names, groups)}",
        hint="add photos in between that overlap both sides by half or more, or run each scene on its own",
    )
