"""Rendered streets with known cameras, and their coarse poses: made once, kept in a folder outside the repository."""

import functools
import hashlib
import json
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import graphgs.structure
from graphgs.commands import synthesize
from graphgs.progress import Reporter
from graphgs.scene.colmap import read_model
from graphgs.scene.reconstruction import Reconstruction
from graphgs.scene.similarity import align, diameter
from graphgs.sources import Photos, SourcesConfig, load_photos
from graphgs.structure.coarse import coarse_poses
from graphgs.structure.config import StructureConfig
from graphgs.structure.feature_cache import FeatureCache
from graphgs.structure.prior import Prior
from graphgs.synth.street import StreetConfig

WIDTH, HEIGHT, CAMERAS = 640, 360, 3
CONFIG = StructureConfig()


@dataclass(frozen=True)
class Street:
    """A drive of a vehicle with three cameras, its photos decoded, its coarse poses estimated."""

    folder: Path  # for what this version of graphgs.structure makes of it
    features: FeatureCache
    photos: Photos
    truth: Reconstruction
    prior: Prior
    coarse_cpu_s: float  # what the coarse poses took; another seed shares the features and matches of the first
    seed: int = 0  # of the mapping

    def error(self, model: Reconstruction) -> float:
        """Median position error in % of the scene's diameter, after alignment; photos that are missing count as off by
        all of it."""
        truth = dict(zip(self.truth.names, self.truth.centers, strict=True))
        target = np.array([truth[name] for name in model.names])
        off = np.linalg.norm(align(model.centers, target).apply(model.centers) - target, axis=1)
        missing = np.full(len(truth) - len(target), diameter(self.truth.centers))
        return 100 * float(np.median(np.concatenate([off, missing]))) / diameter(self.truth.centers)


def street(cache: Path, frames: int, *, seed: int = 0) -> Street:
    """The street of so many frames, each part made unless it is there. The seed is that of its mapping."""
    base = cache / f"street_{frames}x{CAMERAS}_{WIDTH}x{HEIGHT}"
    synthesize("street", base, StreetConfig(frames=frames, cameras=CAMERAS, width=WIDTH, height=HEIGHT, depth=False))
    if not (base / "photos").exists():
        partial = base / "photos.partial"
        load_photos(
            SourcesConfig(decode_max_side=WIDTH), base / "images", partial, reporter=Reporter(), threads=1
        ).save(partial)
        partial.rename(base / "photos")
    photos, features = Photos.load(base / "photos"), FeatureCache(base / "features")
    folder = base / f"made_by_{_version()}"
    folder.mkdir(exist_ok=True)
    stored = folder / f"prior_{seed}"
    if not stored.exists():
        with cpu_seconds() as spent:
            prior = coarse_poses(
                CONFIG, photos, scratch=folder / "coarse", reporter=Reporter(), threads=1, seed=seed,
                cache=features,
            )  # fmt: skip
        partial = folder / f"prior_{seed}.partial"
        prior.save(partial)
        (partial / "cpu.json").write_text(json.dumps(spent))
        partial.rename(stored)
    seconds = json.loads((stored / "cpu.json").read_text())[0]
    return Street(folder, features, photos, read_model(base / "truth"), Prior.load(stored), seconds, seed)


@contextmanager
def cpu_seconds() -> Iterator[list[float]]:
    """Processor time of this process and of the children that end in the block: one number, there at its end."""
    result: list[float] = []
    before = _cpu()
    yield result
    result.append(_cpu() - before)


@functools.cache
def _version() -> str:
    """Of the code whose results are kept; once per run, whatever is edited meanwhile."""
    content = hashlib.sha256()
    for path in sorted(Path(graphgs.structure.__file__).parent.rglob("*.py")):
        content.update(path.read_bytes())
    return content.hexdigest()[:12]


def _cpu() -> float:
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in both)
