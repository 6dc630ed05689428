"""Whether a reconstruction has the right shape, and if not, whether it was said what is wrong with it.

The limits are what one sees: a wall of a hundred metres may be one and a half off at most, a stretch of a drive or a
lens 2 % too long. A right reconstruction of photos that tell their shape is ten times better than that.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from bench.shape_measures import Measures

MEDIAN_LIMIT, LARGEST_LIMIT = 0.3, 1.5  # [% of the diameter] position errors
SCALE_LIMIT, FOCAL_LIMIT = 2.0, 2.0  # [%]
BEND_LIMIT = 4 * MEDIAN_LIMIT  # [% of the diameter]: heights that bend by b are b/4 off in the median
PLACED_LIMIT = 95.0  # [%] of the photos

Defect = Literal["stretch", "bend", "scale", "position", "photos missing"]
Status = Literal["ok", "caution", "partial", "refused", "failed"]
# What a caution has to speak of to name a defect.
WORDS = {
    "stretch": ("focal length", "stretch"),
    "bend": ("bend", "bent", "bow", "dome"),
    "scale": ("scale", "too large", "too small", "times larger", "times smaller"),
}
CAUSES, SYMPTOMS = ("stretch", "bend"), ("scale", "position")


@dataclass(frozen=True)
class Verdict:
    word: Literal["right", "wrong, cautioned", "WRONG AND SILENT", "refused", "incomplete"]
    defects: tuple[Defect, ...]
    needless: bool  # cautioned, though its photos tell their shape

    @property
    def good(self) -> bool:
        return self.word in ("right", "wrong, cautioned")


def defects(measures: Measures) -> tuple[Defect, ...]:
    found: list[Defect] = []
    if measures.focal is not None and abs(measures.focal) > FOCAL_LIMIT:
        found.append("stretch")  # lengths along the view against those across it
    if measures.bend is not None and 100 * abs(measures.bend) / measures.diameter > BEND_LIMIT:
        found.append("bend")
    if abs(measures.local_scale) > SCALE_LIMIT:
        found.append("scale")
    if measures.position_median > MEDIAN_LIMIT or measures.position_largest > LARGEST_LIMIT:
        found.append("position")
    if 100 * measures.placed < PLACED_LIMIT * measures.photos:
        found.append("photos missing")
    return tuple(found)


def judge(
    measures: Measures | None,  # None: there is no reconstruction
    status: Status,
    cautions: Iterable[str],
    *,
    determined: bool | None,
) -> Verdict:
    cautions = tuple(cautions)
    needless = bool(determined) and len(cautions) > 0
    found = () if measures is None else defects(measures)
    if measures is None or status in ("partial", "refused", "failed"):
        return Verdict("refused", found, needless)
    if "photos missing" in found:
        return Verdict("incomplete", found, needless)
    if not found:
        return Verdict("right", found, needless)
    return Verdict("wrong, cautioned" if names(cautions, found) else "WRONG AND SILENT", found, needless)


def names(cautions: Iterable[str], found: tuple[Defect, ...]) -> bool:
    """Whether the cautions name what is wrong: every cause that is there. Where only symptoms are, one of them."""
    said = {
        defect for defect, words in WORDS.items() if any(word in text.lower() for text in cautions for word in words)
    }
    causes = [defect for defect in found if defect in CAUSES]
    return said.issuperset(causes) if causes else bool(said)
