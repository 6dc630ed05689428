"""What became of given poses when they were held against the photos: figures, a verdict, and words for people."""

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from graphgs.errors import DataError
from graphgs.structure.given_evidence import FAR, NOT_NEAR, Errors
from graphgs.structure.given_points import BEHIND

# Sound poses of seven sets were contradicted by .5 to 3.4 % of the matches, which are the matches that are wrong or
# move; the usual mistakes by 19 % (a straight drive whose poses were permuted) to 100 %. A tenth is what the poses of
# our own making are doubted at, too.
FITS = 0.1
# A third of the matches: as if every fifth photo had another's pose, for a match needs two right ones. What is trained
# on such poses is no picture of the scene.
REFUSED = 1 / 3
ASTRAY = 0.1  # of the photos: in rows of alike houses, whose right poses 17 to 65 % of the matches contradict, it is 0
LARGEST_MEDIAN = 0.0025  # of the longer side: 4 px of 1600, up to which points are kept in our own poses
# Points without tracks: a feature is compared with whatever lies beside it, so that edges of things disagree (5 to 8 %
# in a rendered street), and in another frame some agree by chance: 15 % of points twice as far out, 57 % of those that
# a street was shifted along itself by 3 m.
MISPLACED, REFUSED_MISPLACED = 0.4, 0.75
FEWEST = 100  # matches or observations, to judge by

Verdict = Literal["fits", "doubtful", "refused", "open"]


@dataclass(frozen=True)
class Figures:
    """Of some observations of one kind."""

    count: int
    contradicted: float  # share that is more than FAR off
    far_off: float  # share that is more than NOT_NEAR off
    astray: float  # share of the photos that hardly anything bears out, at FAR
    far_astray: float  # the same at NOT_NEAR
    median: float  # how far off, of the longer side
    median_px: float  # the same at the size of the photos' files

    @staticmethod
    def of(
        errors: Errors | None,
        astray: Callable[[Errors, float], float],  # share of photos, at a limit
    ) -> "Figures | None":
        """None where there are too few to judge by."""
        if errors is None or len(errors.error) < FEWEST:
            return None
        shares = (errors.further_than(FAR), errors.further_than(NOT_NEAR))
        return Figures(
            len(errors.error),
            *shares,
            astray(errors, FAR),
            astray(errors, NOT_NEAR),
            errors.median,
            errors.median_px,
        )

    @property
    def repeated(self) -> bool:
        """Whether what contradicts may be parts that look alike: nearly every photo fits its neighbours."""
        return self.astray < ASTRAY

    def verdict(self, *, to_refine: bool = False) -> Verdict:
        """Poses that are to be refined need to be near only."""
        if to_refine:
            return "refused" if self.far_off >= REFUSED and self.far_astray >= ASTRAY else "fits"
        if self.contradicted >= REFUSED and not self.repeated:
            return "refused"
        return "fits" if self.contradicted < FITS and self.median <= LARGEST_MEDIAN else "doubtful"


@dataclass(frozen=True)
class HeldPoses:
    """The artefact of holding given poses against their photos."""

    photos: int  # that were looked at
    posed: int  # photos with given poses
    pairs: int  # with matches
    worst_pair_px: float  # median error of the pair that fits worst but for a tenth
    matches: Figures | None  # against the poses; None: too few matches to judge by
    observations: Figures | None  # of given points; None: there are none
    misplaced: float | None  # share of features that given points without tracks disagree with
    poses: Verdict
    points: Verdict  # open: there are none, or nothing to judge them by
    fits: str = ""  # how the poses would fit
    mend: str = ""  # what a user can do about it

    @property
    def verdict(self) -> Verdict:
        """Of poses and points together."""
        both = (self.poses, self.points)
        return next((v for v in ("refused", "doubtful", "fits") if v in both), "open")

    def describe(self) -> str:
        """One line: what was found, for people."""
        some = f"{self.photos} photos" if self.photos == self.posed else f"{self.photos} of {self.posed} photos"
        if self.verdict == "open":
            return f"the given poses could not be held against the photos: too few matches among {some}"
        if self.verdict == "fits":
            parts = [f"{_figures(self.matches, 'matches')} of {some}"] if self.matches else []
            parts += [f"{_figures(self.observations, 'observations of given points')}"] if self.observations else []
            return f"the given poses fit the photos: {'; '.join(parts) or 'their points lie where matches see them'}"
        return "; ".join(filter(None, (self._poses_said(), self._points_said())))

    @property
    def cautions(self) -> tuple[str, ...]:
        """What should be known of poses that are used all the same."""
        if self.verdict not in ("doubtful", "refused"):
            return ()
        return (f"{self.describe()}; {self.mend}" if self.mend else self.describe(),)

    def refusal(self) -> DataError | None:
        """The error that poses or points which cannot be right end a run with."""
        if self.verdict != "refused":
            return None
        insist = "--allow-partial goes on with them all the same"
        return DataError(self.describe(), hint=f"{self.mend}; {insist}" if self.mend else insist)

    def _poses_said(self) -> str:
        if self.poses not in ("doubtful", "refused"):
            return ""
        # Without matches of our own, it is the observations of given points that the poses were judged by.
        evidence = self.matches or self.observations
        kind = "matches" if self.matches else "observations of given points"
        how = "do not fit" if self.poses == "refused" else "do not quite fit"
        found = f"the poses that came with the input {how} the photos: {_figures(evidence, kind)}"
        if self.fits:
            return f"{found}; they fit {self.fits}"
        if evidence.repeated and evidence.contradicted >= FITS:
            return f"{found}, although each photo fits some others: parts of the scene look alike, or were moved apart"
        return found

    def _points_said(self) -> str:
        if self.points not in ("doubtful", "refused"):
            return ""
        how = "do not lie" if self.points == "refused" else "partly do not lie"
        found = f"the points that came with the input {how} where the photos see them"
        if self.observations is not None:
            found += f": {_figures(self.observations, 'observations')}"
        elif self.misplaced is not None:
            found += f": {100 * self.misplaced:.0f} % of what they should show is at another depth"
        same = self.points == "refused" and self.poses == "fits"
        return f"{found}; the poses do fit, so the points are in another frame or of another scene" if same else found

    def record(self) -> dict:
        """Plain values, for files and events."""
        return dataclasses.asdict(self) | {"verdict": self.verdict}

    def save(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "held.json").write_text(json.dumps(dataclasses.asdict(self), indent=1))

    @staticmethod
    def load(folder: Path) -> "HeldPoses":
        fields = json.loads((folder / "held.json").read_text())
        for name in ("matches", "observations"):
            fields[name] = None if fields[name] is None else Figures(**fields[name])
        return HeldPoses(**fields)


def _figures(figures: Figures, kind: str) -> str:
    off = f"{figures.median_px:.1f} px off" if figures.median < BEHIND else f"{figures.median_px:.0f} px off or more"
    return f"{100 * figures.contradicted:.0f} % of {figures.count} {kind} contradict them, {off} in the median"
