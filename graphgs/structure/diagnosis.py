"""What can be said about a reconstruction beyond its poses: who was left out and why, which
cameras are weak, which pairs object. Kept with the structure, so that later questions need no work.
"""

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos
from graphgs.structure.contradictions import PairSupport, PointLookup, project
from graphgs.structure.edge_width import BLURRED_PX, blur_words
from graphgs.structure.evidence import TriedPairs, VerifiedMatches, read_tried
from graphgs.structure.grouping import Grouping
from graphgs.structure.left_out import LeftOut, PhotoEvidence, left_out
from graphgs.structure.matching import Matches
from graphgs.structure.sharpness import sharpness
from graphgs.structure.soundness import Soundness, Witness

_ARRAYS = ("sharpness", "contrast", "edge_px", "features", "points", "error_px", "objections")
_REFERENCES = 60  # placed photos whose sharpness is measured, to compare those left out with
_SAMPLE = 12  # of them, where none was left out, to tell whether all are blurred


@dataclass(frozen=True)
class Diagnosis:
    """Facts about the photos and their poses. NaN: not measured."""

    names: tuple[str, ...]  # [N] all photos
    sharpness: np.ndarray  # [N]
    contrast: np.ndarray  # [N]
    edge_px: np.ndarray  # [N] width of the edges
    features: np.ndarray  # [N]
    points: np.ndarray  # [N] triangulated points seen; 0 without a pose
    error_px: np.ndarray  # [N] mean reprojection error of what it sees
    tried: TriedPairs
    support: PairSupport  # pairs are indices into the reconstruction's names
    objections: np.ndarray  # [K, 2] int, likewise: pairs that contradict it strongly
    soundness: Soundness
    left_out: tuple[LeftOut, ...]

    def beside(self, photos: list[str], placed: tuple[str, ...]) -> np.ndarray:
        """[len(photos)] int into `placed`: the one that each photo shares most verified matches with; -1 for none."""
        row, node = {name: k for k, name in enumerate(self.names)}, {name: k for k, name in enumerate(placed)}
        result = np.full(len(photos), -1, np.int64)
        verified = np.flatnonzero(self.tried.inliers > 0)
        for index, name in enumerate(photos):
            own = verified[(self.tried.pairs[verified] == row[name]).any(1)]
            for pair in own[np.argsort(self.tried.inliers[own], kind="stable")]:  # the strongest last
                other = self.names[int(self.tried.pairs[pair].sum()) - row[name]]
                result[index] = node.get(other, result[index])
        return result

    @property
    def blur(self) -> str:
        """What is said of photos that are blurred throughout; empty where they are not."""
        measured = self.edge_px[np.isfinite(self.edge_px)]
        typical = float(np.median(measured)) if len(measured) else 0.0
        return f"the photos are {blur_words(typical)}" if typical >= BLURRED_PX else ""

    def cautions(self, matches: Matches) -> tuple[str, ...]:
        """What the result suffers from although photos were placed: crashes, and blur throughout."""
        blur = (f"{self.blur}: poses and scene are less exact than of sharp ones",) if self.blur else ()
        return tuple(crash.describe() for crash in matches.crashes) + blur

    def save(self, folder: Path) -> None:
        """Write diagnosis.json and diagnosis.npz."""
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        support = {f"support_{f.name}": getattr(self.support, f.name) for f in dataclasses.fields(PairSupport)}
        tried = {f"tried_{f.name}": getattr(self.tried, f.name) for f in dataclasses.fields(TriedPairs)}
        np.savez(folder / "diagnosis.npz", **arrays, **support, **tried)
        header = {
            "names": list(self.names),
            "soundness": dataclasses.asdict(self.soundness),
            "left_out": [dataclasses.asdict(entry) for entry in self.left_out],
        }
        (folder / "diagnosis.json").write_text(json.dumps(header, indent=1))

    @staticmethod
    def load(folder: Path) -> "Diagnosis":
        header = json.loads((folder / "diagnosis.json").read_text())
        with np.load(folder / "diagnosis.npz", allow_pickle=False) as stored:
            arrays = dict(stored)
        support = {f.name: arrays.pop(f"support_{f.name}") for f in dataclasses.fields(PairSupport)}
        tried = {f.name: arrays.pop(f"tried_{f.name}") for f in dataclasses.fields(TriedPairs)}
        sound = header["soundness"]
        sound |= {"pair": tuple(sound["pair"]) if sound["pair"] else None, "doubts": tuple(sound["doubts"])}
        return Diagnosis(
            names=tuple(header["names"]),
            **arrays,
            tried=TriedPairs(**tried),
            support=PairSupport(**support),
            soundness=Soundness(**sound),
            left_out=tuple(LeftOut(**entry) for entry in header["left_out"]),
        )


def diagnose(
    photos: Photos,
    matches: Matches,
    grouping: Grouping,
    model: Reconstruction,
    witness: Witness,
    judgement: tuple[Soundness, PairSupport],  # its, of the model
    *,
    threads: int,
) -> Diagnosis:
    """Gather the facts about the chosen model. Reads the photos left out and some others, nothing else."""
    names, n = photos.names, len(photos.names)
    soundness, support = judgement
    row = {name: k for k, name in enumerate(model.names)}
    image_of = np.array([row.get(name, -1) for name in names], np.int64)
    placed = image_of >= 0
    sharp = sharpness(photos, _to_measure(placed), threads=threads)
    tried = read_tried(matches.database)
    evidence = PhotoEvidence(
        names=names,
        placed=placed,
        group=grouping.labels(names),
        sharp=sharp,
        features=matches.features,
        tried=np.bincount(tried.pairs.ravel(), minlength=n),
        verified=np.bincount(matches.edges.ravel(), minlength=n),
        closest=_closest(tried, n),
        mutual=_mutual(matches.edges, n, ~placed),
        seen=_seen(witness.verified, model, image_of),
        crashes={name: crash.describe() for crash in matches.crashes for name in crash.photos},
    )
    points, error_px = _per_photo(model)
    return Diagnosis(
        names=names,
        sharpness=sharp.sharpness,
        contrast=sharp.contrast,
        edge_px=sharp.edge_px,
        features=matches.features,
        points=np.where(placed, points[image_of], 0),
        error_px=np.where(placed, error_px[image_of], np.nan),
        tried=tried,
        support=support,
        objections=witness.objections(support),
        soundness=soundness,
        left_out=left_out(evidence),
    )


def _to_measure(placed: np.ndarray) -> np.ndarray:
    """The photos left out, and placed ones evenly spread."""
    there = np.flatnonzero(placed)
    count = min(len(there), _SAMPLE if placed.all() else _REFERENCES)
    some = there[np.unique(np.linspace(0, len(there) - 1, count).round().astype(int))]
    return np.concatenate([np.flatnonzero(~placed), some])


def _closest(tried: TriedPairs, n: int) -> np.ndarray:
    """[N] most features matched in a pair that did not verify."""
    result = np.zeros(n, np.int64)
    failed = tried.inliers == 0
    for side in range(2):
        np.maximum.at(result, tried.pairs[failed, side], tried.matches[failed])
    return result


def _mutual(edges: np.ndarray, n: int, wanted: np.ndarray) -> np.ndarray:
    """[N] share of the pairs among a photo's partners that are edges too; 1 for fewer than two partners."""
    linked = {(int(i), int(j)) for i, j in np.sort(edges, axis=1)}
    result = np.ones(n)
    for k in np.flatnonzero(wanted):
        partners = np.unique(edges[(edges == k).any(1)])
        partners = partners[partners != k].tolist()
        pairs = [(a, b) for x, a in enumerate(partners) for b in partners[x + 1 :]]
        if pairs:
            result[k] = sum(pair in linked for pair in pairs) / len(pairs)
    return result


def _seen(verified: VerifiedMatches, model: Reconstruction, image_of: np.ndarray) -> np.ndarray:
    """[N] matches whose feature in the other, placed photo has a triangulated point."""
    lookup, pair_of = PointLookup(model), verified.pair_of
    result = np.zeros(len(image_of), np.int64)
    for side, xy in enumerate((verified.xy_i, verified.xy_j)):
        image = image_of[verified.pairs[pair_of, side]]
        there = np.flatnonzero(image >= 0)
        has = there[lookup.points(image[there], xy[there]) >= 0]
        result += np.bincount(verified.pairs[pair_of[has], 1 - side], minlength=len(image_of))
    return result


def _per_photo(model: Reconstruction) -> tuple[np.ndarray, np.ndarray]:
    """(points seen [M], mean reprojection error [M] px) of the model's photos."""
    count = len(model.names)
    point = np.repeat(np.arange(len(model.points)), model.track_lengths)
    seen = project(model, model.track_images, model.points[point])
    error = np.linalg.norm(seen - model.track_xy, axis=1)
    points = np.bincount(model.track_images, minlength=count)
    total = np.bincount(model.track_images, np.nan_to_num(error), minlength=count)
    return points, total / np.maximum(points, 1)
