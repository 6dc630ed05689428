"""Which photos hang together, and which group of them a reconstruction keeps: decided here, once, for all who speak of
it (the message at a run's end, metrics.json, the report, `explain`)."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.components import components
from graphgs.structure.config import StructureConfig
from graphgs.structure.evidence import TriedPairs, read_tried
from graphgs.structure.groups import Bridge, Group, named_groups
from graphgs.structure.matching import Matches
from graphgs.structure.prior import Prior

FEWEST_OF_A_SCENE = 3  # photos: two by themselves could not be reconstructed, so they are no other scene
_LEAST_SHARE = 0.5  # of the usable photos: less of them in one piece is not what was asked for, whatever the rest is


@dataclass(frozen=True)
class Grouping:
    """The groups, and whether so many photos lie outside the kept one that the result is but a part."""

    groups: tuple[Group, ...]  # the kept one first, then every other of at least two photos, the largest first
    alone: tuple[str, ...]  # photos that share features with no other
    apart: int  # photos of the other groups that have no pose
    tolerated: int  # so many of them may be missing
    joined: bool = False  # poses that came with the photos hold all groups together

    @property
    def kept(self) -> Group:
        return self.groups[0]

    @property
    def usable(self) -> int:
        return len(self.alone) + sum(len(group.photos) for group in self.groups)

    @property
    def is_whole(self) -> bool:
        """The kept group is what was asked for. Single photos that fit nothing do not speak against it, unless they are
        the most."""
        return self.joined or (self.apart <= self.tolerated and len(self.kept.photos) >= _LEAST_SHARE * self.usable)

    def describe(self) -> str:
        """Which group is kept and what is left out of it."""
        others = [f"{group.name} ({_count(len(group.photos))})" for group in self.groups[1:]]
        if self.alone:
            others.append(f"{_count(len(self.alone))} that share features with no other")
        kept = f"kept is the group {self.kept.name} ({_count(len(self.kept.photos))})"
        return f"{kept}; without common features with it: {'; '.join(others)}" if others else kept

    def advice(self) -> str:
        """What would join the other groups to the kept one."""
        bridges = [group.bridge.advice() for group in self.groups[1:] if group.bridge is not None]
        return bridges[0] if bridges else "add photos in between that overlap both sides by half or more"

    def labels(
        self,
        names: tuple[str, ...],  # [N] all photos
    ) -> np.ndarray:
        """[N] int: the group of each photo; 0 is the kept one, and each photo alone has a number of its own."""
        members = [*(group.photos for group in self.groups), *((name,) for name in self.alone)]
        label = {name: k for k, photos in enumerate(members) for name in photos}
        return np.array([label[name] for name in names], np.int64)

    def record(self) -> dict[str, Any]:
        return dataclasses.asdict(self)

    @staticmethod
    def from_record(record: dict[str, Any]) -> "Grouping":
        groups = tuple(_group(fields) for fields in record["groups"])
        return Grouping(groups, tuple(record["alone"]), record["apart"], record["tolerated"], record["joined"])

    @staticmethod
    def one(names: tuple[str, ...]) -> "Grouping":
        """Photos that poses of the input hold together, whose features nobody looked at."""
        return Grouping((Group("all photos with a given pose", names),), (), 0, 0, joined=True)


def grouping_of(
    config: StructureConfig, matches: Matches, prior: Prior, model: Reconstruction, *, joined: bool = False
) -> Grouping:
    """The groups that the matches leave, and the one that the final model keeps."""
    placed, tried = np.isin(matches.names, model.names), read_tried(matches.database)
    share = config.max_apart_share
    found = decide_groups(matches.names, matches.edges, placed, tried, prior.similar, max_apart_share=share)
    return dataclasses.replace(found, joined=joined)


def decide_groups(
    names: tuple[str, ...],  # [N] all usable photos
    edges: np.ndarray,  # [E, 2] int, verified pairs
    placed: np.ndarray,  # [N] bool: has a pose in the final model
    tried: TriedPairs,
    similar: np.ndarray,  # [N, k] look-alikes, best first, -1 = none
    *,
    max_apart_share: float,  # of all photos: what other groups may hold at most
) -> Grouping:
    """Kept is the group that holds most of the placed photos: the model says, as the largest group need not be the one
    that could be reconstructed, and of two as large only one was."""
    members = components(len(names), edges)
    kept = max(range(len(members)), key=lambda k: (int(placed[members[k]].sum()), -k))
    rest = [group for k, group in enumerate(members) if k != kept]
    others, single = [group for group in rest if len(group) > 1], [group for group in rest if len(group) == 1]
    tolerated = max(FEWEST_OF_A_SCENE - 1, int(max_apart_share * len(names)))
    return Grouping(
        named_groups(names, [members[kept], *others], tried, similar),
        tuple(names[int(group[0])] for group in single),
        sum(int((~placed[group]).sum()) for group in others),
        tolerated,
    )


def _group(fields: dict[str, Any]) -> Group:
    bridge = None if fields["bridge"] is None else Bridge(**fields["bridge"])
    return Group(fields["name"], tuple(fields["photos"]), bridge)


def _count(photos: int) -> str:
    return "1 photo" if photos == 1 else f"{photos} photos"
