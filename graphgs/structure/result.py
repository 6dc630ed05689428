"""The artefact of the structure stage: the final reconstruction, whether to trust it, and what it lacks."""

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphgs.scene.origin import AT_ZERO, Origin
from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.acceptance import Agreement
from graphgs.structure.calibration.belief import Calibration
from graphgs.structure.diagnosis import Diagnosis
from graphgs.structure.grouping import Grouping
from graphgs.structure.matching import Matches
from graphgs.structure.rigs import RigPose
from graphgs.structure.scale_across import ScaleAcross
from graphgs.structure.world import WorldFrame, from_plain, plain


@dataclass(frozen=True)
class Structure:
    """The final reconstruction with its verified pairs, whether to trust it and why, and the photos it lacks."""

    reconstruction: Reconstruction  # names are photo names, sorted; pixels are those of the decoded photos
    edges: np.ndarray  # [E, 2] int into the reconstruction's names, i < j, sorted
    inliers: np.ndarray  # [E] verified matches; for given points, the points that both photos see
    accepted: bool
    method: str  # the step of the ladder, or what was done with given poses
    agreement: Agreement | None  # with a reconstruction made apart; None where there is none to compare with
    compared_with: str
    grouping: Grouping  # which photos hang together, and which of them this reconstruction keeps
    unregistered: tuple[tuple[str, str], ...]  # (name, reason)
    rigs: tuple[RigPose, ...] = ()  # where the cameras of each rig sit on it
    world: WorldFrame | None = None  # None: the world's scale and axes are arbitrary
    diagnosis: Diagnosis | None = None  # None: nothing was matched
    cautions: tuple[str, ...] = ()  # what the photos leave open, though nothing contradicts the result; for people
    origin: Origin = AT_ZERO  # of the world, in the frame of given poses
    calibration: Calibration | None = None  # what they said of their lenses; None: they were not asked
    upheld: ScaleAcross | None = None  # where it was accepted against the other reconstruction, by its own points

    @property
    def status(self) -> str:
        """partial: the poses are not accepted, or too many photos lie outside the group that was kept."""
        return "ok" if self.accepted and self.grouping.is_whole else "partial"

    @property
    def doubts(self) -> tuple[str, ...]:
        """What speaks against the reconstruction."""
        return () if self.diagnosis is None else self.diagnosis.soundness.doubts

    @property
    def blur(self) -> str:
        """What is said of photos that are blurred throughout; empty where they are not."""
        return "" if self.diagnosis is None else self.diagnosis.blur

    def save(self, folder: Path) -> None:
        self.reconstruction.save(folder)
        np.savez(folder / "edges.npz", edges=self.edges, inliers=self.inliers)
        header = {
            "accepted": self.accepted,
            "method": self.method,
            "agreement": None if self.agreement is None else dataclasses.asdict(self.agreement),
            "compared_with": self.compared_with,
            "grouping": self.grouping.record(),
            "unregistered": [list(entry) for entry in self.unregistered],
            "rigs": len(self.rigs),
            "world": plain(self.world),
            "cautions": list(self.cautions),
            "origin": list(self.origin),
            "upheld": None if self.upheld is None else dataclasses.asdict(self.upheld),
            "calibration": None if self.calibration is None else self.calibration.record(),
        }
        for k, rig in enumerate(self.rigs):
            rig.save(folder / f"rig_{k}.npz")
        if self.diagnosis is not None:
            self.diagnosis.save(folder)
        (folder / "structure.json").write_text(json.dumps(header, indent=1))

    @staticmethod
    def load(folder: Path) -> "Structure":
        header = json.loads((folder / "structure.json").read_text())
        header["agreement"] = None if header["agreement"] is None else Agreement(**header["agreement"])
        header["grouping"] = Grouping.from_record(header["grouping"])
        header["unregistered"] = tuple(tuple(entry) for entry in header["unregistered"])
        header["rigs"] = tuple(RigPose.load(folder / f"rig_{k}.npz") for k in range(header["rigs"]))
        header["world"] = from_plain(header["world"])
        header["cautions"] = tuple(header.get("cautions", ()))  # older ones have none
        header["origin"] = tuple(header.get("origin", AT_ZERO))
        calibration, upheld = header.get("calibration"), header.get("upheld")
        header["upheld"] = None if upheld is None else ScaleAcross(**upheld)
        header["calibration"] = None if calibration is None else Calibration.from_record(calibration)
        header["diagnosis"] = Diagnosis.load(folder) if (folder / "diagnosis.json").is_file() else None
        with np.load(folder / "edges.npz", allow_pickle=False) as arrays:
            return Structure(Reconstruction.load(folder), **dict(arrays), **header)


def edges_among(matches: Matches, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """(edges [E, 2], inliers [E]) of the matches between the named photos, as indices into `names`."""
    row = {name: k for k, name in enumerate(names)}
    index = np.array([row.get(name, -1) for name in matches.names], dtype=np.int64)
    edges = np.sort(index[matches.edges], axis=1)
    both = (edges >= 0).all(1)
    edges, inliers = edges[both], matches.inliers[both]
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    return edges[order], inliers[order]
