"""Photos and pairs at which COLMAP's process dies, whatever is tried: found one by one, left out, and remembered.

A matching or feature worker that a signal ends is started again with less to do (`colmap`). What ends that one too is a
fault that would come back for ever: the pair or the photo that brings it is found, and the work goes on without it.
"""

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from graphgs.structure.colmap import ColmapWorker, WorkerDied, smaller_chunk

Pair = tuple[int, int]

MOST_LOST = 10  # photos or pairs; where more bring death, the machine is at fault and not they
_MOST_FRUITLESS = 3  # deaths that no pair brings when it is tried alone: memory that others take
_OF_ONE_PHOTO = 3  # pairs that died and share a photo: it is the photo


@dataclass(frozen=True)
class Crash:
    """One photo or two whose work ended the process every time."""

    photos: tuple[str, ...]  # names
    by: str  # the signal

    def concerns(self, *pair: str) -> bool:
        """Whether matching these two photos would bring it again."""
        return set(self.photos) <= set(pair)

    def describe(self) -> str:
        what = f"matching {' with '.join(self.photos)}"
        if len(self.photos) == 1:
            what = f"{self.photos[0]}: finding or matching its features"
        left = "left out" if len(self.photos) == 1 else "this pair is left out"
        return f"{what} ends COLMAP's process ({self.by}) every time; {left}"


def match_around_crashes(
    worker: ColmapWorker,
    names: Sequence[str],  # [N] photos
    pairs: list[Pair],  # image indices
    memory: Path,  # a file for what was found, for the run that continues
    *,
    database: Path,
    progress: Callable[[int, int], None],
    **arguments,  # of the job `match`
) -> tuple[Crash, ...]:
    """Match the pairs, but for those and those photos that end the worker. Raises WorkerDied when they are many."""
    pairs, found = [tuple(pair) for pair in pairs], _Found(memory)

    def match(wanted: list[Pair], **less: int) -> None:
        worker.run("match", database=database, pairs=wanted, progress=progress, **arguments | less)

    def culprits(suspects: list[Pair]) -> list[tuple[Pair, WorkerDied]]:
        """Those of a chunk that end the worker: it is halved until they are alone."""
        try:
            match(suspects, threads=1, chunk_pairs=len(suspects), tries=1)
        except WorkerDied as death:
            worker.restart(because=death.message)
            if len(suspects) == 1:
                return [(suspects[0], death)]
            half = len(suspects) // 2
            return culprits(suspects[:half]) + culprits(suspects[half:])
        return []

    fruitless = 0
    while True:
        todo = [pair for pair in pairs if not found.covers(pair)]
        try:
            match(todo)
            return tuple(Crash(tuple(names[k] for k in photos), by) for photos, by in found.crashes.items())
        except WorkerDied as death:
            worker.restart(because=death.message)
            pending = [tuple(pair) for pair in worker.run("unmatched", database=database, pairs=todo)["pairs"]]
            # Chunks are done in order, so what brought death is in the first one, of the size the last worker had.
            guilty = culprits(pending[: smaller_chunk(arguments["chunk_pairs"])])
            for pair, cause in guilty:
                found.add(pair, cause.by)
            fruitless += not guilty
            if found.too_many or fruitless > _MOST_FRUITLESS:
                raise


class _Found:
    """What ended workers so far, kept in a file."""

    def __init__(self, memory: Path):
        self._memory = memory
        self.crashes: dict[tuple[int, ...], str] = {}  # one photo or two -> signal
        self._pairs: dict[Pair, str] = {}
        if memory.exists():
            for *pair, by in json.loads(memory.read_text()):
                self._pairs[tuple(pair)] = by
            self._gather()

    def add(self, pair: Pair, by: str) -> None:
        self._pairs[pair] = by
        self._gather()
        self._memory.write_text(json.dumps([[*pair, by] for pair, by in self._pairs.items()]))

    def covers(self, pair: Pair) -> bool:
        return pair in self._pairs or any((k,) in self.crashes for k in pair)

    @property
    def too_many(self) -> bool:
        return len(self.crashes) > MOST_LOST

    def _gather(self) -> None:
        """Pairs that share a photo are the photo's fault."""
        counts = Counter(k for pair in self._pairs for k in pair)
        bad = {k for k, count in counts.items() if count >= _OF_ONE_PHOTO}
        self.crashes = {}
        for pair, by in self._pairs.items():
            guilty = [k for k in pair if k in bad]
            for photos in [(k,) for k in guilty] or [pair]:
                self.crashes.setdefault(photos, by)
