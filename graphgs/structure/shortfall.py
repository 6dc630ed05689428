"""What is said of a structure that is but a part of what was asked for: one sentence, the same wherever it is said."""

from graphgs.errors import PartialError
from graphgs.structure.config import StructureConfig
from graphgs.structure.result import Structure


def partial_error(
    structure: Structure,
    usable: int,  # photos that a pose was looked for
    limits: StructureConfig,
) -> PartialError | None:
    """Which photos are missing, why, and whether the poses there are can be trusted; None where nothing is missing."""
    if structure.status == "ok":
        return None
    grouping, placed = structure.grouping, len(structure.reconstruction.names)
    reasons = [f"{placed} of {usable} photos placed"]
    if not grouping.is_whole:
        reasons.append(grouping.describe())
    if placed < limits.min_registered * len(grouping.kept.photos):
        reasons.append(f"{len(grouping.kept.photos)} of them hang together")
    doubtful = bool(structure.doubts)
    if structure.blur:
        reasons.append(structure.blur)
    agreed = structure.agreement is not None and structure.agreement.within(limits)
    if not structure.accepted and not agreed:
        doubtful = True
        reasons.append(f"the poses do not agree with {structure.compared_with or 'a second reconstruction'}")
    return PartialError(f"PARTIAL: {'; '.join([*reasons, *structure.doubts])}", hint=_hint(structure, doubtful))


def _hint(structure: Structure, doubtful: bool) -> str:
    if structure.blur:
        advice = "take them again, in focus and with a short exposure"
    elif structure.doubts:
        advice = "the report shows in red what does not fit; add photos that tell the places apart"
    elif not structure.grouping.is_whole:
        advice = f"{structure.grouping.advice()}; or run each group on its own"
    else:
        advice = "the report names the photos and reasons; add photos in between"
    return f"{advice}; or go on with {'these doubtful poses' if doubtful else 'this part'} with --allow-partial"
